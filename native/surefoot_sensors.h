/* The load cells under one robot's feet, one step a sample: loads in, counts out, in C99.

   The specification is sensors/devices/load_cells.py with the stages in sensors/stages and the wire in
   sensors/transport; tests hold the two together. Nothing is allocated, nothing is global, and nothing is read or
   written but what is passed in. Drawing cells is Python's.

       sf_cells_config config;    constants, written by surefoot.sensors.devices.native_cells
       sf_cells cells;            all that is remembered, a plain record that may be copied
       sf_cells_step(&config, &cells, &stream, block, substeps, dt, counts);      once a sample

   Matrices are stored by rows without gaps, as wide as the robot at hand needs. NaN means that no reading arrived,
   so that -ffast-math is not for this file.

   Before it is included: SF_SINGLE makes numbers floats; SF_LOAD_CELLS, SF_SETTLING and SF_PLAYS are the largest sizes,
   as are those of surefoot_stages.h; SF_API is what stands before functions. */

#ifndef SUREFOOT_SENSORS_H
#define SUREFOOT_SENSORS_H

#include "surefoot_stages.h"

#ifndef SF_LOAD_CELLS
#define SF_LOAD_CELLS 32 /* load cells of a robot */
#endif
#ifndef SF_SETTLING
#define SF_SETTLING 8 /* conversions that a chip averages over */
#endif
#ifndef SF_PLAYS
#define SF_PLAYS 8 /* play operators of the hysteresis */
#endif
#define SF_CELLS_OF_A_FOOT 4

typedef struct {
    int channels, clocked, averaged, settling, warms, shears, plays, creeps;
    sf_real highest_rate, slope[SF_LOAD_CELLS], zero_code, noise_counts, scale_drift, offset_drift;
    sf_real temperature_ramp, temperature_rise;
    /* The spring elements. */
    sf_real capacity, nonlinearity, hysteresis, hysteresis_excess, slack[SF_PLAYS], creep_shares[SF_CREEPS];
    sf_real creep_time_constants[SF_CREEPS], impact_threshold, mounting_warp_std, mounting_common_std, overload_share, safe_load;
    sf_wire_config wire;
} sf_cells_config;

/* Fields are those of the Python state, by their way through its parts. */
typedef struct {
    sf_real period[SF_LOAD_CELLS], due[SF_LOAD_CELLS], charge[SF_LOAD_CELLS], held[SF_LOAD_CELLS];
    sf_real error[2 * SF_LOAD_CELLS], thermal[3 * SF_LOAD_CELLS], window[SF_SETTLING * SF_LOAD_CELLS];
    sf_real mechanics_nonlinearity_quadratic[SF_LOAD_CELLS], mechanics_hysteresis_plays[SF_PLAYS * SF_LOAD_CELLS];
    sf_real mechanics_creep_yielded[SF_CREEPS * SF_LOAD_CELLS], mechanics_mounting_offset[SF_LOAD_CELLS];
    sf_real mechanics_mounting_load[SF_LOAD_CELLS], mechanics_mounting_impact[SF_LOAD_CELLS];
    sf_real mechanics_overload_excess[2 * SF_LOAD_CELLS], shear[2 * SF_LOAD_CELLS];
    sf_wire_state wire;
} sf_cells;

/* Whether a config that comes from elsewhere lies within the arrays. */
SF_API int sf_cells_fits(const sf_cells_config *c) {
    int jumps = c->mounting_warp_std > 0 || c->mounting_common_std > 0;
    return c->channels > 0 && c->channels <= SF_LOAD_CELLS && c->settling >= 1 && c->settling <= SF_SETTLING &&
           (c->settling == 1 || c->clocked) && c->plays >= 0 && c->plays <= SF_PLAYS && c->creeps >= 0 &&
           c->creeps <= SF_CREEPS && sf_wire_fits(&c->wire, c->channels) &&
           (!jumps || c->channels % SF_CELLS_OF_A_FOOT == 0);
}

/* ------------------------------------------------------------------------------------ the spring elements */

SF_API void sf_nonlinearity(const sf_cells_config *c, const sf_cells *s, sf_real *load) {
    for (int i = 0; i < c->channels; i++) {
        sf_real u = sf_limit(load[i] / c->capacity, -1, 1);
        load[i] += 4 * s->mechanics_nonlinearity_quadratic[i] * c->capacity * (u - u * u);
    }
}

SF_API void sf_mounting(const sf_cells_config *c, sf_cells *s, sf_random *stream, sf_real *load) {
    static const sf_real warp[SF_CELLS_OF_A_FOOT] = {1, -1, -1, 1};
    int feet = c->channels / SF_CELLS_OF_A_FOOT;
    sf_real warped[SF_LOAD_CELLS] = {0}, common[SF_LOAD_CELLS] = {0};
    if (c->mounting_warp_std > 0) sf_random_fill(stream, 1, feet, warped);
    if (c->mounting_common_std > 0) sf_random_fill(stream, 1, feet, common);
    for (int foot = 0; foot < feet; foot++) {
        sf_real *cell = load + SF_CELLS_OF_A_FOOT * foot;
        sf_real *offset = s->mechanics_mounting_offset + SF_CELLS_OF_A_FOOT * foot;
        sf_real sum = cell[0] + cell[1] + cell[2] + cell[3];
        int hit = isfinite(sum) && fabs(sum - s->mechanics_mounting_load[foot]) > c->impact_threshold;
        for (int i = 0; i < SF_CELLS_OF_A_FOOT; i++) {
            if (hit && s->mechanics_mounting_impact[foot] < (sf_real)0.5)
                offset[i] += warped[foot] * (c->mounting_warp_std * warp[i]) + common[foot] * c->mounting_common_std;
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
    for (int i = 0; i < c->channels && c->plays; i++)
        load[i] = sf_hysteresis(c->hysteresis, c->hysteresis_excess, c->capacity, c->slack, c->plays,
                                s->mechanics_hysteresis_plays + i, c->channels, load[i]);
    if (c->creeps)
        sf_creep(c->creep_shares, c->creep_time_constants, c->creeps, dt, c->channels, s->mechanics_creep_yielded, load);
    if (c->mounting_warp_std > 0 || c->mounting_common_std > 0) sf_mounting(c, s, stream, load);
    if (c->overload_share > 0) sf_overload(c, s, load);
}

/* -------------------------------------------------------------------------------------------- the converter */

/* How many loads of the cells stand in a row: vertical ones, and with shear those along x and y after them. */
SF_API int sf_loads(const sf_cells_config *c) { return c->shears ? 3 * c->channels : c->channels; }

/* The force in a row that cell i takes for a vertical one. */
SF_API sf_real sf_felt(const sf_cells_config *c, const sf_cells *s, const sf_real *row, int i) {
    int K = c->channels;
    return c->shears ? row[i] + s->shear[i] * row[K + i] + s->shear[K + i] * row[2 * K + i] : row[i];
}

/* The integral of what cell i feels, constant in each of the substeps of a block, from its start up to a time. */
SF_API sf_real sf_integral(const sf_cells_config *c, const sf_cells *s, const sf_real *block, int i, int rows,
                           sf_real step, sf_real time) {
    int last = time > 0 ? (int)(time / step) : 0, wide = sf_loads(c);
    sf_real sum = 0;
    if (last > rows - 1) last = rows - 1;
    for (int row = 0; row < last; row++) sum += sf_felt(c, s, block + row * wide, i);
    return sum * step + (time - last * step) * sf_felt(c, s, block + last * wide, i);
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

/* ------------------------------------------------------------------------------------------------- the step */

/* Read the cells: loads in N (sf_loads of them) at the ends of equal substeps that fill dt, a row each, to counts, one a
   cell. */
SF_API void sf_cells_step(const sf_cells_config *c, sf_cells *s, sf_random *stream, const sf_real *block,
                          int substeps, sf_real dt, sf_real *counts) {
    int K = c->channels, wide = sf_loads(c), most = (int)(c->highest_rate * dt) + 1, draws = 0;
    int acts = c->nonlinearity > 0 || c->plays || c->creeps || c->mounting_warp_std > 0 || c->mounting_common_std > 0 ||
               c->overload_share > 0;
    int remembers = acts || c->settling > 1;
    sf_real step = dt / substeps;
    sf_real number[SF_LOAD_CELLS], load[SF_LOAD_CELLS], drawn[3 * SF_LOAD_CELLS], root = (sf_real)sqrt(dt);
    for (int i = 0; i < K; i++) {
        number[i] = 0, load[i] = sf_felt(c, s, block + (substeps - 1) * wide, i);
        if (c->averaged) {
            load[i] = 0;
            for (int row = 0; row < substeps; row++) load[i] += sf_felt(c, s, block + row * wide, i);
            load[i] /= substeps;
        }
        if (c->clocked) {
            number[i] = (sf_real)floor((dt - s->due[i]) / s->period[i]);
            sf_real period = s->period[i], at = s->due[i] + number[i] * period;
            sf_real total = 0, end = 0, begin = -s->charge[i];
            for (int row = 0; row < substeps; row++) total += sf_felt(c, s, block + row * wide, i);
            total *= step;
            s->due[i] = at + (period - dt);
            if (number[i] >= 0) end = sf_integral(c, s, block, i, substeps, step, at);
            if (number[i] >= 1) begin = sf_integral(c, s, block, i, substeps, step, at - period);
            int known = number[i] >= 1 || (number[i] >= 0 && isfinite(s->charge[i]));
            load[i] = known ? (end - begin) / period : total / dt;
            s->charge[i] = number[i] >= 0 ? total - end : s->charge[i] + total;
            if (remembers && !isfinite(s->charge[i])) s->charge[i] = (sf_real)NAN;
        }
        if (remembers && !isfinite(load[i])) load[i] = (sf_real)NAN;
    }
    if (acts) sf_mechanics(c, s, stream, dt, load);
    draws = (c->scale_drift > 0) + (c->offset_drift > 0) + (c->noise_counts > 0);
    if (draws) sf_random_fill(stream, 1, draws * K, drawn);
    for (int i = 0; i < K; i++) {
        sf_real *scale = s->error + i, *offset = s->error + K + i;
        const sf_real *own = drawn + i;
        if (c->scale_drift > 0) *scale += *own * (root * c->scale_drift), own += K;
        if (c->offset_drift > 0) *offset += *own * (root * c->offset_drift), own += K;
        if (c->warms) {
            sf_real *rise = s->thermal + 2 * K + i, before = *rise;
            *rise = sf_warmed(before, c->temperature_ramp, c->temperature_rise, dt);
            *scale += s->thermal[i] * (*rise - before);
            *offset += s->thermal[K + i] * (*rise - before);
        }
        sf_real bridge = load[i] * (1 + *scale) + *offset;
        if (c->settling > 1) bridge = sf_settle(c, s->window + i, bridge, number[i] + 1, most);
        sf_real code = bridge * c->slope[i] + c->zero_code;
        if (c->noise_counts > 0) code += c->noise_counts * *own;
        if (number[i] >= 0) s->held[i] = sf_code(&c->wire, i, code);
        counts[i] = s->held[i];
    }
    sf_wire(&c->wire, K, &s->wire, stream, dt, counts);
}

#endif
