/* The baselines of the moment filter for one robot's feet, one step per sample, in C99: a tare of feet in swing,
   and the starting map without corrections. The specification is calibration/baselines.py. Functions have the names
   of the Python functions, and tests compare the two. Checks, lag and estimates are those of surefoot_robot.h. Fields
   of its sf_config that only the moment filter uses are zero. Standard deviations and covariances are NaN.

       sf_tare_init(&config, &state);
       sf_tare_step(&config, &tare, &state, raw, &reference, dt, &estimate); once per sample
       sf_tare_begin(&config, &state); at the start of an episode, keeps the offsets

   Without corrections: sf_front_init and sf_uncorrected_step. */

#ifndef SUREFOOT_TARE_H
#define SUREFOOT_TARE_H

#include "surefoot_robot.h"

typedef struct {
    int settle, minimum_samples;
    sf_real spread, limit; /* N */
} sf_tare_config;

/* TareState */
typedef struct {
    sf_front front;
    sf_whole airborne[SF_CHANNELS], count[SF_CHANNELS];
    sf_real mean[SF_CHANNELS], scatter[SF_CHANNELS], offset[SF_CHANNELS];
} sf_tare_state;

/* FrontEnd.estimate: apply a correction (a, b in N) to the newest forces. */
SF_API void sf_corrected(const sf_config *c, const sf_front *s, const sf_sample *sample, const sf_real *a,
                         const sf_real *b, sf_estimate *out) {
    sf_real rows[3 * SF_CHANNELS], change[SF_CHANNELS];
    for (int i = 0; i < c->channels; i++) {
        change[i] = a[i] * sample->change[i];
        out->force[i] = a[i] * sample->force[i] + b[i];
        out->force_aligned[i] = a[i] * sample->aligned[i] + b[i];
        out->scale[i] = a[i] * c->scale[i];
        out->offset[i] = a[i] * c->offset[i] + b[i];
        out->flags[i] = sample->flags[i];
        out->force_std[i] = (sf_real)NAN;
    }
    for (int i = 0; i < 4; i++) out->cop_covariance[i] = (sf_real)NAN;
    out->nis = (sf_real)NAN;
    out->nis_rows = 0;
    sf_level_rows(c, s->motion, rows);
    sf_report_now(c, s, rows, change, out);
}

SF_API void sf_tare_init(const sf_config *c, sf_tare_state *s) {
    memset(s, 0, sizeof *s);
    sf_front_init(c, &s->front);
}

/* begin_episode: keep the offsets. */
SF_API void sf_tare_begin(const sf_config *c, sf_tare_state *s) {
    sf_real offset[SF_CHANNELS];
    sf_copy(offset, s->offset, SF_CHANNELS);
    sf_tare_init(c, s);
    sf_copy(s->offset, offset, SF_CHANNELS);
}

/* tare: take in one sample; arguments as of sf_moment_step. */
SF_API void sf_tare_step(const sf_config *c, const sf_tare_config *t, sf_tare_state *s, const sf_real *raw,
                         const sf_reference *reference, sf_real dt, sf_estimate *estimate) {
    int K = c->channels, enough[SF_CHANNELS], hangs[SF_FEET];
    sf_real ones[SF_CHANNELS], means[SF_FEET] = {0};
    sf_sample sample;
    sf_check(c, &s->front, raw, reference, dt, &sample);
    sf_align(c, &s->front, &sample);
    for (int foot = 0; foot < c->feet; foot++) hangs[foot] = 1;
    for (int i = 0; i < K; i++) {
        int foot = c->foot_of_channel[i], used;
        sf_real past = sample.past[i], before = s->mean[i], number;
        /* Across a gap the foot may have stood: what was counted before is not of this swing. */
        s->airborne[i] = reference->swing[foot] && sample.sound ? (sample.gap ? 0 : s->airborne[i]) + 1 : 0;
        used = s->airborne[i] > t->settle && sample.past[K + i] > (sf_real)0.5;
        if (s->airborne[i] == 1) s->count[i] = 0;
        /* Welford's running mean and scatter of this swing. */
        if (s->count[i] == 0) before = s->scatter[i] = 0;
        s->count[i] += used;
        number = (sf_real)(s->count[i] > 0 ? s->count[i] : 1);
        s->mean[i] = before + (used ? (past - before) / number : 0);
        s->scatter[i] += used ? (past - before) * (past - s->mean[i]) : 0;
        enough[i] = used && s->count[i] >= t->minimum_samples;
        if (!enough[i]) continue;
        means[foot] += s->mean[i];
        hangs[foot] = hangs[foot] && s->scatter[i] <= number * (t->spread * t->spread) &&
                      sf_fabs(s->mean[i]) <= t->limit;
    }
    /* Where one channel carries load, or all together do, the foot did not swing. */
    for (int i = 0; i < K; i++) {
        int foot = c->foot_of_channel[i], hanging = hangs[foot] && sf_fabs(means[foot]) <= t->limit;
        if (enough[i] && hanging) s->offset[i] = -s->mean[i];
        if (enough[i] && !hanging) sample.flags[i] |= SF_REJECTED;
        ones[i] = 1;
    }
    sf_corrected(c, &s->front, &sample, ones, s->offset, estimate);
}

/* uncorrected: take in one sample; arguments as of sf_moment_step. */
SF_API void sf_uncorrected_step(const sf_config *c, sf_front *s, const sf_real *raw,
                                const sf_reference *reference, sf_real dt, sf_estimate *estimate) {
    sf_real ones[SF_CHANNELS], zeros[SF_CHANNELS];
    sf_sample sample;
    sf_check(c, s, raw, reference, dt, &sample);
    sf_align(c, s, &sample);
    for (int i = 0; i < c->channels; i++) ones[i] = 1, zeros[i] = 0;
    sf_corrected(c, s, &sample, ones, zeros, estimate);
}

#endif
