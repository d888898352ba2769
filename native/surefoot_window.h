/* The methods that the moment filter is compared with, for one robot's feet, one step a sample, in C99: the
   CoP paper's sliding window (Eq. 14), with `quasi_static` Han's; a tare of swinging feet; the starting map as
   it is. The specification is the Python in calibration/window, standing.py and baselines.py; functions have its
   names, and tests hold the two together. Checks, lag and estimates are those of surefoot_robot.h, whose
   sf_config says what these methods know of the robot; what is the moment filter's own in it stays zero. They
   claim no certainty: deviations and covariances of their estimates are NaN.

       sf_window_init(&config, &window, &state);
       sf_window_step(&config, &window, &state, &work, raw, &reference, imu, dt, &estimate); once a sample
       sf_window_begin(&config, &state); an episode, with what was learnt in the last one

   and sf_tare_init, sf_tare_step and sf_tare_begin, sf_front_init and sf_uncorrected_step. Before it is
   included: SF_WINDOW is the longest window, SF_EVERY the most samples from update to update. */

#ifndef SUREFOOT_WINDOW_H
#define SUREFOOT_WINDOW_H

#include "surefoot_robot.h"

#ifndef SF_EVERY
#define SF_EVERY 16 /* samples from update to update */
#endif

#ifndef SF_WINDOW
#define SF_WINDOW 100 /* samples: half a second at 200 Hz */
#endif

#define SF_SIGNALS (6 * SF_CHANNELS + 1)
#define SF_START (2 * SF_CHANNELS + 3)
#define SF_MEDIAN_OF_SQUARE ((sf_real)0.79)

/* ------------------------------------------------------------------------------------------------ records */

/* Constants of a SlidingWindow and its QuietStanding. Pairs: of a scale, of an offset in body weights. */
typedef struct {
    int every, length, settle, transition, iterations, quasi_static, filtered;
    int standing_start, standing_samples;
    sf_real force, cop; /* what residuals are measured in: sqrt(w_F) / (M g), sqrt(w_P) / L */
    sf_real gross_force, gross_length, outlier, least; /* N, m, squared deviations, samples */
    sf_real spread[2], step_bound[2], rate_bound[2], lowest[2], highest[2];
    sf_real transfer[9], steady[2]; /* the low-pass filter */
    double warm_up, duration, patience;
    sf_real deviation[2], noise[3], shared[3], largest, acceleration_threshold, rate_threshold;
} sf_window_config;

/* StandingState */
typedef struct {
    double time;
    sf_whole samples, dropped, gated;
    sf_real information[SF_START * SF_START], gradient[SF_START], energy;
} sf_standing;

/* WindowState */
typedef struct {
    sf_front front;
    sf_whole step;
    sf_real pending[SF_EVERY * (SF_CHANNELS + SF_MOTION + 2 * SF_FEET + 2)];
    sf_real filter[2 * SF_SIGNALS], latest[SF_SIGNALS];
    sf_whole started, contact[2 * SF_FEET], since_change;
    sf_real samples[SF_WINDOW * (SF_SIGNALS + 2)], theta[2 * SF_CHANNELS];
    sf_whole status, walking, all_walking;
    sf_standing standing;
} sf_window_state;

/* Numbers on the way to an answer, of which nothing is remembered. */
typedef struct {
    sf_real A[SF_START * SF_START], J[3 * SF_START], gradient[SF_START], theta[2 * SF_CHANNELS];
    sf_real use[SF_WINDOW], square[SF_WINDOW], ordered[SF_WINDOW];
} sf_window_work;

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

/* Return whether a window fits into the arrays; call it once for one that comes from elsewhere. */
SF_API int sf_window_fits(const sf_config *c, const sf_window_config *w) {
    return sf_robot_fits(c) && w->every >= 1 && w->every <= SF_EVERY && w->every <= w->length && w->length <= SF_WINDOW;
}

/* FrontEnd.estimate: apply a correction (a, b in N) to the newest forces. */
SF_API void sf_corrected(const sf_config *c, const sf_front *s, const sf_sample *sample, const sf_real *a,
                         const sf_real *b, sf_whole status, sf_estimate *out) {
    sf_real rows[3 * SF_CHANNELS], change[SF_CHANNELS];
    for (int i = 0; i < c->channels; i++) {
        change[i] = a[i] * sample->change[i];
        out->force[i] = a[i] * sample->force[i] + b[i];
        out->force_aligned[i] = a[i] * sample->aligned[i] + b[i];
        out->scale[i] = a[i] * c->scale[i];
        out->offset[i] = a[i] * c->offset[i] + b[i];
        out->flags[i] = sample->flags[i] | status;
        out->force_std[i] = (sf_real)NAN;
    }
    for (int i = 0; i < 4; i++) out->cop_covariance[i] = (sf_real)NAN;
    out->nis = (sf_real)NAN;
    out->nis_rows = 0;
    sf_level_rows(c, s->motion, rows);
    sf_report_now(c, s, rows, change, out);
}

/* ----------------------------------------------------------------------------------------- standing start */

SF_API sf_real sf_length(const sf_real *v) { return sf_sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

/* QuietStanding.update: take in one sample that is held against (Fz, px, py) = asked. */
SF_API void sf_stand(const sf_config *c, const sf_window_config *w, const sf_front *front, sf_standing *s,
                     const sf_real *force, int usable, const sf_real *asked, sf_real dt, sf_window_work *work) {
    int K = c->channels, n = 2 * K + 3, quiet;
    sf_real rows[3 * SF_CHANNELS], total[3], *J = work->J;
    int warm = s->time >= w->warm_up - 1e-9;
    s->time += (double)dt;
    if (!warm) return;
    for (int i = 0; i < K; i++) usable = usable && sf_fabs(force[i]) <= w->largest;
    for (int i = 1; i < 3; i++) usable = usable && sf_fabs(asked[i]) <= SF_LARGEST_REFERENCE;
    s->dropped += !usable;
    if (!usable) return;
    sf_level_rows(c, front->motion, rows);
    for (int i = 0; i < 3; i++) {
        if (i) sf_add(rows + i * K, -asked[i], rows, K);
        total[i] = sf_dot(rows + i * K, force, K);
    }
    quiet = total[0] > c->force_threshold &&
            sf_fabs(sf_length(front->motion + SF_ACCELEROMETER) - c->gravity) < w->acceleration_threshold &&
            sf_length(front->motion + SF_GYROSCOPE) < w->rate_threshold;
    s->gated += !quiet;
    s->samples += quiet;
    for (int i = 0; quiet && i < 3; i++, J += n) {
        sf_real target = ((i ? 0 : c->weight) - total[i]) / w->noise[i];
        for (int k = 0; k < K; k++) {
            J[k] = rows[i * K + k] * force[k] * w->deviation[0] / w->noise[i];
            J[K + k] = rows[i * K + k] * w->deviation[1] / w->noise[i];
        }
        for (int k = 0; k < 3; k++) J[2 * K + k] = k == i ? w->shared[i] / w->noise[i] : 0;
        for (int k = 0; k < n; k++) sf_add(s->information + k * n, J[k], J, n);
        sf_add(s->gradient, target, J, n);
        s->energy += target * target;
    }
}

/* SlidingWindow._stand: collect the standing start, and end it. */
SF_API void sf_window_stand(const sf_config *c, const sf_window_config *w, sf_window_state *s,
                            const sf_sample *sample, const sf_reference *reference, sf_real dt,
                            sf_window_work *work) {
    int K = c->channels, n = 2 * K + 3, leaving, ready;
    sf_standing *stand = &s->standing;
    sf_real asked[3];
    int physical = sf_ground(c, s->front.motion, w->quasi_static, asked);
    sf_stand(c, w, &s->front, stand, sample->past, sample->good && physical, asked, sample->gap ? c->dt : dt, work);
    leaving = stand->time > w->patience;
    for (int foot = 0; foot < c->feet; foot++) leaving = leaving || (reference->swing[foot] && sample->sound);
    leaving = leaving && !s->walking;
    ready = leaving || stand->time >= w->warm_up + w->duration - 1e-9;
    ready = ready && !s->walking && stand->samples >= w->standing_samples;
    if (ready) {
        sf_copy(work->A, stand->information, n * n);
        sf_copy(work->gradient, stand->gradient, n);
        for (int i = 0; i < n; i++) work->A[i * n + i] += 1;
        if (sf_cholesky(work->A, n, n)) sf_solve(work->A, n, n, work->gradient, 1);
        for (int i = 0; i < 2 * K; i++) {
            int part = i >= K;
            sf_real shift = work->gradient[i] * w->deviation[part];
            s->theta[i] = sf_clip(part ? shift / c->weight : 1 + shift, w->lowest[part], w->highest[part]);
        }
    }
    s->all_walking = s->walking = s->walking || ready || leaving;
}

/* ------------------------------------------------------------------------------------- the sliding window */

/* SlidingWindow._collect: pass the pending samples through the filter into the window. */
SF_API void sf_window_collect(const sf_config *c, const sf_window_config *w, sf_window_state *s) {
    int K = c->channels, R = sf_motion(c), feet = c->feet, signals = 6 * K + 1;
    sf_real *newest = s->samples + (w->length - w->every) * (signals + 2);
    memmove(s->samples, s->samples + w->every * (signals + 2),
            (size_t)((w->length - w->every) * (signals + 2)) * sizeof(sf_real));
    for (int t = 0; t < w->every; t++, newest += signals + 2) {
        const sf_real *past = s->pending + t * (K + R + 2 * feet + 2);
        const sf_real *motion = past + K, *notes = motion + R;
        sf_real rows[3 * SF_CHANNELS], asked[3], loads[SF_FEET] = {0}, total[3] = {0, 0, 0};
        int physical = sf_ground(c, motion, w->quasi_static, asked), unchanged = 1;
        int good = physical && notes[2 * feet] > (sf_real)0.5;
        sf_level_rows(c, motion, rows);
        for (int i = 0; i < K; i++) {
            sf_real force = s->theta[i] * past[i] + s->theta[K + i] * c->weight;
            loads[c->foot_of_channel[i]] += rows[i] * force;
            for (int k = 0; k < 3; k++) total[k] += rows[k * K + i] * force;
        }
        for (int k = 1; k < 3; k++)
            good = good && sf_fabs(total[k] - asked[k] * total[0]) <= w->gross_length * total[0];
        good = good && sf_fabs(total[0] - asked[0]) <= w->gross_force;
        for (int k = 0; good && k < 3; k++)
            for (int i = 0; i < K; i++) {
                sf_real row = k ? rows[k * K + i] - asked[k] * rows[i] : rows[i];
                s->latest[2 * k * K + i] = row * past[i];
                s->latest[(2 * k + 1) * K + i] = row * c->weight;
            }
        if (good) s->latest[6 * K] = asked[0];
        for (int i = 0; i < signals; i++) {
            sf_real x = s->latest[i], *one = s->filter + i, *two = one + signals, a, b;
            newest[i] = x;
            if (!w->filtered) continue;
            a = s->started ? *one : w->steady[0] * x;
            b = s->started ? *two : w->steady[1] * x;
            newest[i] = w->transfer[0] * x + w->transfer[1] * a + w->transfer[2] * b;
            *one = w->transfer[3] * x + w->transfer[4] * a + w->transfer[5] * b;
            *two = w->transfer[6] * x + w->transfer[7] * a + w->transfer[8] * b;
        }
        s->started = s->started || good;
        for (int i = 0; i < 2 * feet; i++) {
            sf_whole now = i < feet ? loads[i] > c->force_threshold : notes[i - feet] > (sf_real)0.5;
            unchanged = unchanged && now == s->contact[i];
            s->contact[i] = now;
        }
        for (int foot = 0; foot < feet; foot++) unchanged = unchanged && notes[feet + foot] > (sf_real)0.5;
        s->since_change = unchanged ? s->since_change + 1 : 0;
        newest[signals] = (sf_real)(good && notes[2 * feet + 1] > (sf_real)0.5);
        newest[signals + 1] = (sf_real)(s->since_change < w->transition);
    }
}

/* linearise: the residuals of one sample, and their derivatives by theta over the spread into J, if there is
   one; returns whether the sample counts. */
SF_API int sf_linearise(const sf_config *c, const sf_window_config *w, const sf_real *theta,
                        const sf_real *phi, sf_real residual[3], sf_real *J) {
    int K = c->channels, M = 2 * K;
    sf_real fz = sf_dot(phi, theta, M), per, off[3];
    if (!(fz > c->force_threshold)) return 0;
    per = 1 / fz;
    residual[0] = w->force * (fz - phi[3 * M]);
    for (int k = 1; k < 3; k++) {
        off[k] = sf_dot(phi + k * M, theta, M) * per;
        residual[k] = w->cop * off[k];
    }
    for (int i = 0; J && i < M; i++) {
        sf_real unit = w->spread[i >= K], vertical = phi[i] * unit;
        J[i] = w->force * vertical;
        for (int k = 1; k < 3; k++) J[k * M + i] = w->cop * per * (phi[k * M + i] * unit - off[k] * vertical);
    }
    return 1;
}

/* shorten: scale a change down until every parameter's part is within its bound. */
SF_API void sf_shorten(const sf_config *c, sf_real *change, const sf_real bound[2]) {
    int K = c->channels;
    sf_real excess = 1;
    for (int i = 0; i < 2 * K; i++) excess = sf_max(excess, sf_fabs(change[i]) / bound[i >= K]);
    for (int i = 0; i < 2 * K; i++) change[i] /= excess;
}

/* gauss_newton: into work->theta; returns whether the normal equations could be solved safely. */
SF_API int sf_gauss_newton(const sf_config *c, const sf_window_config *w, const sf_window_state *s,
                           sf_window_work *work) {
    int K = c->channels, M = 2 * K;
    sf_real *H = work->A, *J = work->J, *g = work->gradient, *theta = work->theta, trace = 1, r[3];
    sf_copy(theta, s->theta, M);
    for (int iteration = 0; iteration < w->iterations; iteration++) {
        memset(H, 0, (size_t)(M * M) * sizeof(sf_real));
        for (int i = 0; i < M; i++) g[i] = (theta[i] - s->theta[i]) / w->spread[i >= K];
        for (int t = 0; t < w->length; t++) {
            const sf_real *phi = s->samples + t * (3 * M + 3);
            if (!(work->use[t] > (sf_real)0.5) || !sf_linearise(c, w, theta, phi, r, J)) continue;
            for (int k = 0; k < 3; k++) {
                const sf_real *row = J + k * M;
                for (int i = 0; i < M; i++) sf_add(H + i * M + i, row[i], row + i, M - i);
                sf_add(g, r[k], row, M);
            }
        }
        for (int i = 0; i < M; i++) {
            if (iteration == 0) trace += H[i * M + i];
            H[i * M + i] += 1;
        }
        if (!(trace < (sf_real)0.01 / SF_EPSILON)) return 0;
        if (!sf_cholesky(H, M, M)) g[0] = (sf_real)NAN; /* beyond all numbers */
        else sf_solve(H, M, M, g, 1);
        for (int i = 0; i < M; i++) g[i] *= w->spread[i >= K];
        sf_shorten(c, g, w->step_bound);
        sf_add(theta, -1, g, M);
    }
    return 1;
}

/* SlidingWindow._solve: solve Eq. 14, with every bound that keeps a bad window from doing harm. */
SF_API void sf_window_solve(const sf_config *c, const sf_window_config *w, sf_window_state *s, sf_window_work *work) {
    int K = c->channels, M = 2 * K, used = 0, enough, solvable;
    sf_real r[3], typical = 0, count = 0, *theta = work->theta;
    for (int t = 0; t < w->length; t++) {
        const sf_real *phi = s->samples + t * (3 * M + 3);
        work->use[t] = 0;
        if (!(phi[3 * M + 1] > (sf_real)0.5) || !sf_linearise(c, w, s->theta, phi, r, 0)) continue;
        work->use[t] = 1;
        sf_real square = work->square[t] = (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) / 3;
        int at = used++;
        for (; at > 0 && work->ordered[at - 1] > square; at--) work->ordered[at] = work->ordered[at - 1];
        work->ordered[at] = square;
    }
    if (used) typical = work->ordered[(used - 1) / 2] / SF_MEDIAN_OF_SQUARE; /* typical_square */
    for (int t = 0; t < w->length; t++) {
        int changing = s->samples[t * (3 * M + 3) + 3 * M + 2] > (sf_real)0.5;
        sf_real limit = w->outlier * sf_max(typical, 1);
        if (work->use[t] > 0 && changing && work->square[t] > limit) work->use[t] = 0;
        count += work->use[t];
    }
    enough = count >= w->least;
    solvable = sf_gauss_newton(c, w, s, work);
    for (int i = 0; i < M; i++) theta[i] -= s->theta[i];
    sf_shorten(c, theta, w->rate_bound);
    for (int i = 0; i < M; i++)
        theta[i] = sf_clip(s->theta[i] + theta[i], w->lowest[i >= K], w->highest[i >= K]);
    if (enough && solvable && s->walking && sf_all_finite(theta, M)) sf_copy(s->theta, theta, M);
    s->status = !s->walking ? 0 : !enough ? SF_NO_CONTACT : solvable ? 0 : SF_SINGULAR;
}

/* begin_episode: keep what was learnt of the sensors, and whether the standing start is over. */
SF_API void sf_window_begin(const sf_config *c, sf_window_state *s) {
    sf_front_init(c, &s->front);
    memset(s->pending, 0, sizeof s->pending);
    memset(s->filter, 0, sizeof s->filter);
    memset(s->latest, 0, sizeof s->latest);
    memset(s->contact, 0, sizeof s->contact);
    memset(s->samples, 0, sizeof s->samples);
    s->started = s->since_change = s->status = 0;
}

/* SlidingWindow.init */
SF_API void sf_window_init(const sf_config *c, const sf_window_config *w, sf_window_state *s) {
    memset(s, 0, sizeof *s);
    sf_front_init(c, &s->front);
    for (int i = 0; i < c->channels; i++) s->theta[i] = 1;
    s->walking = s->all_walking = !w->standing_start;
}

/* SlidingWindow.update: take in one sample. raw, reference and dt as of sf_moment_step; imu: what
   accelerometer and gyroscope measured then in the IMU's axes, in m/s^2 and rad/s. */
SF_API void sf_window_step(const sf_config *c, const sf_window_config *w, sf_window_state *s,
                           sf_window_work *work, const sf_real *raw, const sf_reference *reference,
                           const sf_real *const imu[2], sf_real dt, sf_estimate *estimate) {
    int K = c->channels, R = sf_motion(c), feet = c->feet, width = K + R + 2 * feet + 2;
    sf_sample sample;
    sf_real b[SF_CHANNELS], *newest = s->pending + (w->every - 1) * width;
    sf_check(c, &s->front, raw, reference, imu, dt, &sample);
    sf_align(c, &s->front, &sample);
    if (!s->all_walking) sf_window_stand(c, w, s, &sample, reference, dt, work);
    if (sample.gap) { /* _without_samples */
        memset(s->pending, 0, sizeof s->pending);
        memset(s->samples, 0, sizeof s->samples);
        s->started = 0;
    }
    memmove(s->pending, s->pending + width, (size_t)((w->every - 1) * width) * sizeof(sf_real));
    sf_copy(newest, sample.past, K);
    sf_copy(newest + K, s->front.motion, R);
    newest += K + R;
    for (int foot = 0; foot < feet; foot++) {
        int stance = reference->stance[foot] && sample.sound, swing = reference->swing[foot] && sample.sound;
        newest[foot] = (sf_real)stance;
        newest[feet + foot] = (sf_real)(stance || swing);
    }
    newest[2 * feet] = (sf_real)sample.good;
    newest[2 * feet + 1] = (sf_real)(s->front.clean > w->settle && s->walking);
    if (++s->step % w->every == 0) {
        sf_window_collect(c, w, s);
        sf_window_solve(c, w, s, work);
    }
    for (int i = 0; i < K; i++) b[i] = s->theta[K + i] * c->weight;
    sf_corrected(c, &s->front, &sample, s->theta, b, s->status | (s->walking ? 0 : SF_STANDING), estimate);
}

/* -------------------------------------------------------------------------------------- tare, uncorrected */

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
    sf_check(c, &s->front, raw, reference, 0, dt, &sample);
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
    sf_corrected(c, &s->front, &sample, ones, s->offset, 0, estimate);
}

/* uncorrected: take in one sample; arguments as of sf_moment_step. */
SF_API void sf_uncorrected_step(const sf_config *c, sf_front *s, const sf_real *raw,
                                const sf_reference *reference, sf_real dt, sf_estimate *estimate) {
    sf_real ones[SF_CHANNELS], zeros[SF_CHANNELS];
    sf_sample sample;
    sf_check(c, s, raw, reference, 0, dt, &sample);
    sf_align(c, s, &sample);
    for (int i = 0; i < c->channels; i++) ones[i] = 1, zeros[i] = 0;
    sf_corrected(c, s, &sample, ones, zeros, 0, estimate);
}

#endif
