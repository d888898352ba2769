/* The load cells under one robot's feet, one step a sample: loads in, counts out, in C99.

   The specification is sensors/devices/load_cells.py with the stages in sensors/stages and the wire in
   sensors/transport; tests hold the two together. Nothing is allocated, nothing is global, and nothing is read or
   written but what is passed in. Drawing cells is Python's.

       sf_cells_config config;    constants, written by surefoot.sensors.devices.native_cells
       sf_cells cells;            all that is remembered, a plain record that may be copied
       sf_cells_step(&config, &cells, &stream, block, substeps, dt, counts);      once a sample

   Matrices are stored by rows without gaps, as wide as the robot at hand needs. NaN means that no reading arrived,
   so that -ffast-math is not for this file.

   Before it is included: SF_SINGLE makes numbers floats; SF_LOAD_CELLS, SF_WINDOW, SF_PLAYS, SF_CREEPS and SF_UNDER_WAY are
   the largest sizes; SF_API is what stands before functions. */

#ifndef SUREFOOT_SENSORS_H
#define SUREFOOT_SENSORS_H

#include <math.h>
#include <string.h>

#include "surefoot_random.h"

#ifndef SF_LOAD_CELLS
#define SF_LOAD_CELLS 16 /* load cells of a robot */
#endif
#ifndef SF_WINDOW
#define SF_WINDOW 8 /* conversions that a chip averages over */
#endif
#ifndef SF_PLAYS
#define SF_PLAYS 8 /* play operators of the hysteresis */
#endif
#ifndef SF_CREEPS
#define SF_CREEPS 4 /* exponentials of the creep */
#endif
#ifndef SF_UNDER_WAY
#define SF_UNDER_WAY 16 /* readings under way on the wire */
#endif
#define SF_CELLS_OF_A_FOOT 4

typedef struct {
    int channels, clocked, settling, converts, warms, plays, creeps, bits, offset_binary, late, under_way;
    sf_real highest_rate, slope[SF_LOAD_CELLS], zero_code, lowest, highest, noise, scale_walk, offset_walk;
    sf_real temperature_ramp, temperature_rise;
    /* The spring elements. */
    sf_real capacity, nonlinearity, hysteresis, hysteresis_excess, slack[SF_PLAYS], creep_share[SF_CREEPS];
    sf_real creep_time[SF_CREEPS], impact_threshold, warp_std, common_std, overload_share, safe_load;
    /* The wire. */
    sf_real spike_rate, spike_size, wrong_words, stale_repeats, packet_loss, packet_loss_length, gap_share;
    sf_real gap_length, delay, jitter;
} sf_cells_config;

/* Fields are those of the Python state, by their way through its parts. */
typedef struct {
    sf_real period[SF_LOAD_CELLS], due[SF_LOAD_CELLS], previous[SF_LOAD_CELLS], held[SF_LOAD_CELLS], error[2 * SF_LOAD_CELLS];
    sf_real thermal[3 * SF_LOAD_CELLS], window[SF_WINDOW * SF_LOAD_CELLS];
    sf_real mechanics_nonlinearity_quadratic[SF_LOAD_CELLS], mechanics_hysteresis_plays[SF_PLAYS * SF_LOAD_CELLS];
    sf_real mechanics_creep_yielded[SF_CREEPS * SF_LOAD_CELLS], mechanics_mounting_offset[SF_LOAD_CELLS];
    sf_real mechanics_mounting_load[SF_LOAD_CELLS], mechanics_mounting_impact[SF_LOAD_CELLS];
    sf_real mechanics_overload_excess[2 * SF_LOAD_CELLS];
    sf_real wire_stale_repeats_held[SF_LOAD_CELLS], wire_packet_loss_lost[1], wire_gaps_lost[1];
    sf_real wire_latency_due[SF_UNDER_WAY], wire_latency_readings[SF_UNDER_WAY * SF_LOAD_CELLS];
    sf_real wire_latency_held[SF_LOAD_CELLS];
} sf_cells;

/* Whether a config that comes from elsewhere lies within the arrays. */
SF_API int sf_cells_fits(const sf_cells_config *c) {
    int jumps = c->warp_std > 0 || c->common_std > 0;
    return c->channels > 0 && c->channels <= SF_LOAD_CELLS && c->settling >= 1 && c->settling <= SF_WINDOW &&
           (c->settling == 1 || c->clocked) && c->plays >= 0 && c->plays <= SF_PLAYS && c->creeps >= 0 &&
           c->creeps <= SF_CREEPS && c->under_way >= 1 && c->under_way <= SF_UNDER_WAY && c->bits >= 0 &&
           c->bits <= 32 && (!jumps || c->channels % SF_CELLS_OF_A_FOOT == 0);
}

/* Clip; NaN stays. */
SF_API sf_real sf_limit(sf_real value, sf_real low, sf_real high) {
    return value < low ? low : value > high ? high : value;
}

/* ------------------------------------------------------------------------------------ the spring elements */

SF_API void sf_nonlinearity(const sf_cells_config *c, const sf_cells *s, sf_real *load) {
    for (int i = 0; i < c->channels; i++) {
        sf_real u = sf_limit(load[i] / c->capacity, -1, 1);
        load[i] += 4 * s->mechanics_nonlinearity_quadratic[i] * c->capacity * (u - u * u);
    }
}

SF_API void sf_hysteresis(const sf_cells_config *c, sf_cells *s, sf_real *load) {
    int K = c->channels;
    for (int i = 0; i < K; i++) {
        sf_real *plays = s->mechanics_hysteresis_plays + i, sum = 0;
        /* The smallest play lies within the slack of all others: fed to them, it moves none. */
        sf_real felt = isfinite(load[i]) ? load[i] / c->capacity : plays[(c->plays - 1) * K];
        for (int p = 0; p < c->plays; p++) {
            plays[p * K] = sf_limit(plays[p * K], felt - c->slack[p], felt + c->slack[p]);
            sum += plays[p * K];
        }
        load[i] += c->capacity *
                   (c->hysteresis * (sum + plays[(c->plays - 1) * K]) - c->hysteresis_excess * felt);
    }
}

SF_API void sf_creep(const sf_cells_config *c, sf_cells *s, sf_real dt, sf_real *load) {
    int K = c->channels;
    sf_real followed[SF_CREEPS];
    for (int j = 0; j < c->creeps; j++) followed[j] = (sf_real)expm1(-dt / c->creep_time[j]);
    for (int i = 0; i < K; i++) {
        sf_real felt = load[i];
        for (int j = 0; j < c->creeps; j++) {
            sf_real *yielded = s->mechanics_creep_yielded + j * K + i;
            if (isfinite(felt)) *yielded -= followed[j] * (felt - *yielded);
            load[i] += c->creep_share[j] * *yielded;
        }
    }
}

SF_API void sf_mounting(const sf_cells_config *c, sf_cells *s, sf_random *stream, sf_real *load) {
    static const sf_real warp[SF_CELLS_OF_A_FOOT] = {1, -1, -1, 1};
    int feet = c->channels / SF_CELLS_OF_A_FOOT;
    sf_real warped[SF_LOAD_CELLS], common[SF_LOAD_CELLS];
    memset(warped, 0, sizeof warped);
    memset(common, 0, sizeof common);
    if (c->warp_std > 0) sf_random_fill(stream, 1, feet, warped);
    if (c->common_std > 0) sf_random_fill(stream, 1, feet, common);
    for (int foot = 0; foot < feet; foot++) {
        sf_real *cell = load + SF_CELLS_OF_A_FOOT * foot;
        sf_real *offset = s->mechanics_mounting_offset + SF_CELLS_OF_A_FOOT * foot;
        sf_real sum = cell[0] + cell[1] + cell[2] + cell[3];
        int hit = isfinite(sum) && fabs(sum - s->mechanics_mounting_load[foot]) > c->impact_threshold;
        for (int i = 0; i < SF_CELLS_OF_A_FOOT; i++) {
            if (hit && s->mechanics_mounting_impact[foot] < (sf_real)0.5)
                offset[i] += warped[foot] * (c->warp_std * warp[i]) + common[foot] * c->common_std;
            cell[i] += offset[i];
        }
        if (isfinite(sum)) s->mechanics_mounting_load[foot] = sum;
        s->mechanics_mounting_impact[foot] = (sf_real)hit;
    }
}

SF_API void sf_overload(const sf_cells_config *c, sf_cells *s, sf_real *load) {
    for (int i = 0; i < c->channels; i++) {
        sf_real *most = s->mechanics_overload_excess + i, *least = most + c->channels;
        sf_real excess = load[i] - sf_limit(load[i], -c->safe_load, c->safe_load);
        if (isfinite(excess)) {
            if (excess > *most) *most = excess;
            if (excess < *least) *least = excess;
        }
        load[i] += c->overload_share * (*most + *least);
    }
}

SF_API void sf_mechanics(const sf_cells_config *c, sf_cells *s, sf_random *stream, sf_real dt, sf_real *load) {
    for (int i = 0; i < c->channels; i++)
        if (!isfinite(load[i])) load[i] = (sf_real)NAN;
    if (c->nonlinearity > 0) sf_nonlinearity(c, s, load);
    if (c->plays) sf_hysteresis(c, s, load);
    if (c->creeps) sf_creep(c, s, dt, load);
    if (c->warp_std > 0 || c->common_std > 0) sf_mounting(c, s, stream, load);
    if (c->overload_share > 0) sf_overload(c, s, load);
}

/* -------------------------------------------------------------------------------------------- the converter */

/* The signal between the substeps of a block, at a position from 0 (its start) to its number of rows. */
SF_API sf_real sf_interpolate(const sf_real *block, int rows, int channels, sf_real previous, sf_real position) {
    int row = position > 0 ? (position < rows - 1 ? (int)position : rows - 1) : 0;
    sf_real start = row ? block[(row - 1) * channels] : previous;
    return start + (position - row) * (block[row * channels] - start);
}

/* Return the mean of the last conversions of a chip that finished `came` more. */
SF_API sf_real sf_settle(const sf_cells_config *c, sf_real *window, sf_real signal, sf_real came, int most) {
    int K = c->channels, n = c->settling, sound = isfinite(signal);
    sf_real now = came > 0 && sound ? signal : window[0], step = window[0] - now, sum = 0;
    step = (isnan(step) ? 0 : step) / (came < 1 ? 1 : came);
    for (int push = 0; push < most && push < n - 1; push++) {
        /* 1 where there was another conversion, which goes in front, and 0 elsewhere. */
        sf_real another = sf_limit(came - push, 0, 1);
        for (int i = n - 1; i > 0; i--) {
            sf_real *lag = window + i * K;
            *lag += another * ((i > 1 ? lag[-K] + step : step) - *lag);
        }
    }
    window[0] = now;
    for (int i = 1; i < n; i++) sum += window[i * K];
    return sound ? now + sum / n : (sf_real)NAN;
}

/* ------------------------------------------------------------------------------------------------- the wire */

SF_API void sf_spikes(const sf_cells_config *c, sf_random *stream, sf_real dt, sf_real *counts) {
    sf_real hit[SF_LOAD_CELLS], size[SF_LOAD_CELLS], probability = (sf_real)-expm1(-c->spike_rate * dt);
    sf_random_fill(stream, 0, c->channels, hit);
    sf_random_fill(stream, 1, c->channels, size);
    for (int i = 0; i < c->channels; i++) {
        sf_real off = counts[i] + c->spike_size * size[i];
        if (c->bits) off = (sf_real)rint(sf_limit(off, c->lowest, c->highest));
        if (hit[i] < probability) counts[i] = off;
    }
}

SF_API void sf_wrong_words(const sf_cells_config *c, sf_random *stream, sf_real *counts) {
    sf_real hit[SF_LOAD_CELLS], which[SF_LOAD_CELLS];
    sf_random_fill(stream, 0, c->channels, hit);
    sf_random_fill(stream, 0, c->channels, which);
    for (int i = 0; i < c->channels; i++) {
        int number = (int)sf_limit(which[i] * c->bits, 0, (sf_real)(c->bits - 1));
        sf_real place = (sf_real)ldexp(1.0, number);
        sf_real worth = number == c->bits - 1 && !c->offset_binary ? -place : place;
        sf_real above = (sf_real)floor(counts[i] / place);
        sf_real bit = above - 2 * (sf_real)floor(above / 2);
        if (hit[i] < c->wrong_words) counts[i] += (1 - 2 * bit) * worth;
    }
}

SF_API void sf_stale_repeats(const sf_cells_config *c, sf_cells *s, sf_random *stream, sf_real *counts) {
    sf_real drawn, *held = s->wire_stale_repeats_held;
    sf_random_fill(stream, 0, 1, &drawn);
    for (int i = 0; i < c->channels; i++) {
        if (drawn < c->stale_repeats && !isnan(held[i])) counts[i] = held[i];
        held[i] = counts[i];
    }
}

SF_API void sf_burst_gaps(const sf_cells_config *c, sf_real share, sf_real length, sf_real *lost,
                          sf_random *stream, sf_real dt, sf_real *counts) {
    sf_real drawn, decayed = (sf_real)-expm1(-dt / (length * (1 - share)));
    sf_random_fill(stream, 0, 1, &drawn);
    *lost = drawn < *lost * (1 - decayed) + decayed * share;
    if (*lost > 0)
        for (int i = 0; i < c->channels; i++) counts[i] = (sf_real)NAN;
}

SF_API void sf_latency(const sf_cells_config *c, sf_cells *s, sf_random *stream, sf_real dt, sf_real *counts) {
    int K = c->channels, D = c->under_way, arrived = 0;
    sf_real drawn, *due = s->wire_latency_due, *row = s->wire_latency_readings, *held = s->wire_latency_held;
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

SF_API void sf_wire(const sf_cells_config *c, sf_cells *s, sf_random *stream, sf_real dt, sf_real *counts) {
    if (c->spike_rate > 0) sf_spikes(c, stream, dt, counts);
    if (c->wrong_words > 0) sf_wrong_words(c, stream, counts);
    if (c->stale_repeats > 0) sf_stale_repeats(c, s, stream, counts);
    if (c->packet_loss > 0)
        sf_burst_gaps(c, c->packet_loss, c->packet_loss_length, s->wire_packet_loss_lost, stream, dt, counts);
    if (c->gap_share > 0)
        sf_burst_gaps(c, c->gap_share, c->gap_length, s->wire_gaps_lost, stream, dt, counts);
    if (c->late) sf_latency(c, s, stream, dt, counts);
}

/* ------------------------------------------------------------------------------------------------- the step */

/* Rise of the temperature since power-up in K, after the cells have warmed for dt more. */
SF_API sf_real sf_warmed(const sf_cells_config *c, sf_real temperature, sf_real dt) {
    sf_real rise = c->temperature_rise;
    if (rise == 0) return temperature + c->temperature_ramp * dt;
    return rise + (temperature - rise) * (sf_real)exp(-c->temperature_ramp * dt / rise);
}

/* Read the cells: loads in N at the ends of equal substeps that fill dt, a row each, to counts, one a cell. */
SF_API void sf_cells_step(const sf_cells_config *c, sf_cells *s, sf_random *stream, const sf_real *block,
                          int substeps, sf_real dt, sf_real *counts) {
    int K = c->channels, most = (int)(c->highest_rate * dt) + 1, draws = 0;
    int acts = c->nonlinearity > 0 || c->plays || c->creeps || c->warp_std > 0 || c->common_std > 0 ||
               c->overload_share > 0;
    int remembers = acts || c->settling > 1;
    sf_real number[SF_LOAD_CELLS], load[SF_LOAD_CELLS], drawn[3 * SF_LOAD_CELLS], root = (sf_real)sqrt(dt);
    for (int i = 0; i < K; i++) {
        const sf_real *own = block + i;
        sf_real last = own[(substeps - 1) * K], previous = s->previous[i];
        number[i] = 0, load[i] = last;
        if (c->clocked) {
            number[i] = (sf_real)floor((dt - s->due[i]) / s->period[i]);
            sf_real at = s->due[i] + number[i] * s->period[i];
            s->due[i] = at + (s->period[i] - dt);
            load[i] = sf_interpolate(own, substeps, K, previous, at < 0 ? 0 : at * (substeps / dt));
        }
        s->previous[i] = last;
        if (remembers && !isfinite(last)) s->previous[i] = c->clocked ? previous : (sf_real)NAN;
    }
    if (acts) sf_mechanics(c, s, stream, dt, load);
    draws = (c->scale_walk > 0) + (c->offset_walk > 0) + (c->noise > 0);
    if (draws) sf_random_fill(stream, 1, draws * K, drawn);
    for (int i = 0; i < K; i++) {
        sf_real *scale = s->error + i, *offset = s->error + K + i;
        const sf_real *own = drawn + i;
        if (c->scale_walk > 0) *scale += *own * (root * c->scale_walk), own += K;
        if (c->offset_walk > 0) *offset += *own * (root * c->offset_walk), own += K;
        if (c->warms) {
            sf_real *rise = s->thermal + 2 * K + i, temperature = sf_warmed(c, *rise, dt);
            *scale += s->thermal[i] * (temperature - *rise);
            *offset += s->thermal[K + i] * (temperature - *rise);
            *rise = temperature;
        }
        sf_real bridge = load[i] * (1 + *scale) + *offset;
        if (c->settling > 1) bridge = sf_settle(c, s->window + i, bridge, number[i] + 1, most);
        sf_real code = bridge * c->slope[i] + c->zero_code;
        if (c->noise > 0) code += c->noise * *own;
        if (c->converts) code = (sf_real)rint(sf_limit(code, c->lowest, c->highest));
        if (number[i] >= 0) s->held[i] = code;
        counts[i] = s->held[i];
    }
    sf_wire(c, s, stream, dt, counts);
}

#endif
