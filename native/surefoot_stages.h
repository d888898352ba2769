/* What load cells and six-axis sensors have in common, in C99: laws of a spring element, and the wire to the host.

   The specification is sensors/stages and sensors/transport; a function has the name of the Python that it is equal to.
   surefoot_sensors.h and surefoot_force_torque.h include this.

   Before it is included: SF_ON_WIRE, SF_CREEPS and SF_UNDER_WAY are the largest sizes. */

#ifndef SUREFOOT_STAGES_H
#define SUREFOOT_STAGES_H

#include "surefoot_random.h"

#ifndef SF_ON_WIRE
#define SF_ON_WIRE 48 /* channels of a device */
#endif
#ifndef SF_CREEPS
#define SF_CREEPS 4 /* exponentials of the creep */
#endif
#ifndef SF_UNDER_WAY
#define SF_UNDER_WAY 16 /* readings under way on the wire */
#endif

/* Converters end where the wire's codes do. No bits: there is no converter. */
typedef struct {
    int bits, offset_binary, late, under_way;
    sf_real lowest[SF_ON_WIRE], highest[SF_ON_WIRE], spike_size[SF_ON_WIRE];
    sf_real spike_rate, wrong_words, stale_repeats, packet_loss, packet_loss_length, gap_share, gap_length;
    sf_real delay, jitter;
} sf_wire_config;

typedef struct {
    sf_real stale_repeats_held[SF_ON_WIRE], packet_loss_lost[1], gaps_lost[1], latency_due[SF_UNDER_WAY];
    sf_real latency_readings[SF_UNDER_WAY * SF_ON_WIRE], latency_held[SF_ON_WIRE];
} sf_wire_state;

/* Whether a wire of K channels that comes from elsewhere lies within the arrays. */
SF_API int sf_wire_fits(const sf_wire_config *c, int K) {
    return K > 0 && K <= SF_ON_WIRE && c->under_way >= 1 && c->under_way <= SF_UNDER_WAY && c->bits >= 0 &&
           c->bits <= 32;
}

/* Clip; NaN stays. */
SF_API sf_real sf_limit(sf_real value, sf_real low, sf_real high) {
    return value < low ? low : value > high ? high : value;
}

/* What a converter makes of a channel's signal in counts. */
SF_API sf_real sf_code(const sf_wire_config *c, int i, sf_real signal) {
    return c->bits ? (sf_real)rint(sf_limit(signal, c->lowest[i], c->highest[i])) : signal;
}

/* ------------------------------------------------------------------------------------ the spring elements */

/* What one of K channels reads of a load by its plays, which lie K apart. */
SF_API sf_real sf_hysteresis(sf_real share, sf_real excess, sf_real full_scale, const sf_real *slack,
                             int count, sf_real *plays, int K, sf_real load) {
    sf_real *smallest = plays + (count - 1) * K, sum = 0;
    /* The smallest play lies within the slack of all others: fed to them, it moves none. */
    sf_real felt = isfinite(load) ? load / full_scale : *smallest;
    for (int p = 0; p < count; p++) {
        plays[p * K] = sf_limit(plays[p * K], felt - slack[p], felt + slack[p]);
        sum += plays[p * K];
    }
    return load + full_scale * (share * (sum + *smallest) - excess * felt);
}

/* Let K channels creep for dt. */
SF_API void sf_creep(const sf_real *share, const sf_real *time, int count, sf_real dt, int K,
                     sf_real *yielded, sf_real *load) {
    sf_real followed[SF_CREEPS];
    for (int j = 0; j < count; j++) followed[j] = (sf_real)expm1(-dt / time[j]);
    for (int i = 0; i < K; i++) {
        sf_real felt = load[i];
        for (int j = 0; j < count; j++) {
            sf_real *part = yielded + j * K + i;
            if (isfinite(felt)) *part -= followed[j] * (felt - *part);
            load[i] += share[j] * *part;
        }
    }
}

/* Rise of the temperature since power-up in K, after a device has warmed for dt more. */
SF_API sf_real sf_warmed(sf_real temperature, sf_real ramp, sf_real rise, sf_real dt) {
    if (rise == 0) return temperature + ramp * dt;
    return rise + (temperature - rise) * (sf_real)exp(-ramp * dt / rise);
}

/* ------------------------------------------------------------------------------------------------- the wire */

SF_API void sf_spikes(const sf_wire_config *c, int K, sf_random *stream, sf_real dt, sf_real *counts) {
    sf_real hit[SF_ON_WIRE], size[SF_ON_WIRE], probability = (sf_real)-expm1(-c->spike_rate * dt);
    sf_random_fill(stream, 0, K, hit);
    sf_random_fill(stream, 1, K, size);
    for (int i = 0; i < K; i++) {
        sf_real off = sf_code(c, i, counts[i] + c->spike_size[i] * size[i]);
        if (hit[i] < probability) counts[i] = off;
    }
}

SF_API void sf_wrong_words(const sf_wire_config *c, int K, sf_random *stream, sf_real *counts) {
    sf_real hit[SF_ON_WIRE], which[SF_ON_WIRE];
    sf_random_fill(stream, 0, K, hit);
    sf_random_fill(stream, 0, K, which);
    for (int i = 0; i < K; i++) {
        int number = (int)sf_limit(which[i] * c->bits, 0, (sf_real)(c->bits - 1));
        sf_real place = (sf_real)ldexp(1.0, number);
        sf_real worth = number == c->bits - 1 && !c->offset_binary ? -place : place;
        sf_real above = (sf_real)floor(counts[i] / place);
        sf_real bit = above - 2 * (sf_real)floor(above / 2);
        if (hit[i] < c->wrong_words) counts[i] += (1 - 2 * bit) * worth;
    }
}

SF_API void sf_stale_repeats(const sf_wire_config *c, int K, sf_real *held, sf_random *stream,
                             sf_real *counts) {
    sf_real drawn;
    sf_random_fill(stream, 0, 1, &drawn);
    for (int i = 0; i < K; i++) {
        if (drawn < c->stale_repeats && !isnan(held[i])) counts[i] = held[i];
        held[i] = counts[i];
    }
}

SF_API void sf_burst_gaps(sf_real share, sf_real length, int K, sf_real *lost, sf_random *stream, sf_real dt,
                          sf_real *counts) {
    sf_real drawn, decayed = (sf_real)-expm1(-dt / (length * (1 - share)));
    sf_random_fill(stream, 0, 1, &drawn);
    *lost = drawn < *lost * (1 - decayed) + decayed * share;
    if (*lost > 0)
        for (int i = 0; i < K; i++) counts[i] = (sf_real)NAN;
}

SF_API void sf_latency(const sf_wire_config *c, int K, sf_wire_state *s, sf_random *stream, sf_real dt,
                       sf_real *counts) {
    int D = c->under_way, arrived = 0;
    sf_real drawn, *due = s->latency_due, *row = s->latency_readings, *held = s->latency_held;
    sf_random_fill(stream, 1, 1, &drawn);
    drawn = c->jitter * drawn + c->delay;
    if (drawn < 0) drawn = 0;
    sf_real last = due[D - 1] - dt;
    for (int d = 0; d < D - 1; d++) due[d] = due[d + 1] - dt;
    due[D - 1] = drawn > last ? drawn : last;
    memmove(row, row + K, (size_t)((D - 1) * K) * sizeof *row);
    memcpy(row + (D - 1) * K, counts, (size_t)K * sizeof *row);
    for (int d = 0; d < D; d++) arrived += due[d] <= 0;
    /* Readings come in order, so their number is the row; none leaves the last that came before. */
    if (arrived) memcpy(held, row + (arrived - 1) * K, (size_t)K * sizeof *row);
    memcpy(counts, held, (size_t)K * sizeof *row);
}

SF_API void sf_wire(const sf_wire_config *c, int K, sf_wire_state *s, sf_random *stream, sf_real dt,
                    sf_real *counts) {
    if (c->spike_rate > 0) sf_spikes(c, K, stream, dt, counts);
    if (c->wrong_words > 0) sf_wrong_words(c, K, stream, counts);
    if (c->stale_repeats > 0) sf_stale_repeats(c, K, s->stale_repeats_held, stream, counts);
    if (c->packet_loss > 0)
        sf_burst_gaps(c->packet_loss, c->packet_loss_length, K, s->packet_loss_lost, stream, dt, counts);
    if (c->gap_share > 0) sf_burst_gaps(c->gap_share, c->gap_length, K, s->gaps_lost, stream, dt, counts);
    if (c->late) sf_latency(c, K, s, stream, dt, counts);
}

#endif
