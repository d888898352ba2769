/* The calibrator of one robot's feet, one step a sample: surefoot's moment filter in C99.

   The specification is the Python in calibration/front_end and calibration/moment; docs/estimator.md derives it and
   docs/native.md tells how to use this file. A function here has the name of the Python function that it is equal to,
   and tests hold the two together. Nothing is allocated, nothing is global, and nothing is read or written but what is
   passed in.

       sf_config config;         constants of the robot, written by surefoot.calibration.native.config
       sf_state state;           all that is remembered, a plain record that may be copied
       sf_calibrator_init(&config, &state);
       sf_calibrator_step(&config, &state, raw, &reference, dt, &estimate);      once a sample

   or, with a small stack, sf_calibrator_init_with and sf_calibrator_step_with, in a record sf_work of the caller's.

   Matrices are stored by rows without gaps, as wide as the robot at hand needs: arrays below hold the largest one.

   Before it is included: SF_EVERY, SF_SETTLE, SF_GROUPS, SF_KINDS, SF_SENSORS, SF_CELLS, SF_TALKS and SF_PARITIES are the
   largest sizes, besides those of surefoot_robot.h. */

#ifndef SUREFOOT_CALIBRATION_H
#define SUREFOOT_CALIBRATION_H

#ifdef SUREFOOT_ROBOT_H
#error "surefoot_calibration.h comes before the other headers, as it adds to sf_config"
#endif

#ifndef SF_EVERY
#define SF_EVERY 16 /* samples of a block */
#endif
#ifndef SF_SETTLE
#define SF_SETTLE 4
#endif
#ifndef SF_GROUPS
#define SF_GROUPS 8 /* `every` over `average` */
#endif
#ifndef SF_KINDS
#define SF_KINDS 6 /* 3 is enough where no foot has six axes */
#endif
#ifndef SF_SENSORS
#define SF_SENSORS 4 /* instruments of all feet */
#endif
#ifndef SF_CELLS
#define SF_CELLS 8 /* channels that are cells under a plate */
#endif
#ifndef SF_PARITIES
#define SF_PARITIES 6 /* axes that two instruments of a foot see, both feet */
#endif
#ifndef SF_TALKS
#define SF_TALKS 10 /* five for each six-axis sensor, 0 for cells alone */
#endif

#define SF_SCALES (SF_CHANNELS + SF_TALKS)
#define SF_MAP (SF_SCALES + SF_CHANNELS)
#define SF_UNKNOWNS (SF_MAP + 10)
#define SF_SPAN (SF_EVERY + 2 * SF_SETTLE)
#define SF_PENDING (2 * SF_CHANNELS + SF_MOTION + SF_FEET + 2)
#define SF_NEWTON (SF_GROUPS * SF_KINDS)
#define SF_ROWS (SF_NEWTON + 2 * SF_PARITIES > SF_CHANNELS ? SF_NEWTON + 2 * SF_PARITIES : SF_CHANNELS)
#define SF_PAIRS (SF_CELLS * (SF_CELLS - 1) / 2 + 1)
#define SF_HYPOTHESES (2 * SF_CHANNELS + 2 * SF_PAIRS)

/* What it adds to sf_config: a MomentFilterConfig, worked out. P scales, of which the first K are the channels' own,
   M = P + K scales and offsets, N = M + 10 unknowns. */
#define SF_OF_METHOD \
    int every, average, settle, kinds, sensors, parities, pairs, keep_every, distal_matters, talks; \
    int talk_to[SF_TALKS + 1], talk_from[SF_TALKS + 1]; /* channels of the scales behind the first K */ \
    int first[SF_PAIRS], second[SF_PAIRS];              /* cells that may be exchanged */ \
    int foot_of_sensor[SF_SENSORS]; \
    sf_real unit[SF_CHANNELS]; \
    sf_real start[SF_UNKNOWNS], first_variance[SF_UNKNOWNS], walk[SF_UNKNOWNS], learnt[SF_UNKNOWNS], sure[SF_UNKNOWNS]; \
    sf_real change[SF_UNKNOWNS]; /* variances of what a load changes */ \
    sf_real stated[SF_MAP]; \
    sf_real row_scale[6], row_variance[6]; /* of the kinds of rows that are seen */ \
    sf_real timing_noise, gate, reject, still, mass_change; \
    sf_real swing_noise, swing_load, parity_noise; \
    sf_real parity[SF_PARITIES * SF_CHANNELS]; \
    sf_real load_largest[3], load_loose[3]; \
    sf_real sensor_mass[SF_SENSORS], sensor_com[SF_SENSORS * 3], sensor_share[SF_SENSORS * 6]; \
    sf_real felt[SF_SENSORS * 6 * SF_CHANNELS]; \
    sf_real curve_every[SF_EVERY], curve_span[SF_SPAN];

#include "surefoot_robot.h"

/* Constants of the Python modules, by their names there. */
#define SF_REJECT_STD ((sf_real)8.0)
#define SF_LEAP_STD ((sf_real)5.0)
#define SF_LEAST_CHANGE_OF_MASS ((sf_real)0.5)
#define SF_SETTLED ((sf_real)50.0)
#define SF_PASSES 4
#define SF_LOAD_STD ((sf_real)4.0)
#define SF_UNSURE ((sf_real)0.06)
#define SF_LONGEST_PAUSE ((sf_real)3600.0)
#define SF_REACH ((sf_real)12.0)
#define SF_STRIDE ((sf_real)1.5)
#define SF_STILL ((sf_real)0.5)
#define SF_ROUNDING ((sf_real)1e-12)
#define SF_SPREAD ((sf_real)1.0)
#define SF_ALL ((sf_real)2.0)
#define SF_SHARED ((sf_real)0.015)
#define SF_WRONG ((sf_real)0.003)
#define SF_LEAST_LOAD ((sf_real)0.1)
#define SF_SWING_SAMPLES ((sf_real)16.0)
#define SF_RATE_MEMORY ((sf_real)0.15)
#define SF_FASTEST ((sf_real)100.0)
#define SF_FEWEST_SAMPLES ((sf_real)8.0)
#define SF_FEWEST_CHANNELS ((sf_real)2.5)
#define SF_SURE_STD ((sf_real)3.0)
#define SF_LONGEST_STANCE ((sf_real)4.0)
#define SF_LARGEST_SCALE ((sf_real)3.0)
#define SF_FIRST_NOISE ((sf_real)16.0)
#define SF_LOUDEST ((sf_real)100.0)
#define SF_LARGEST_SQUARE ((sf_real)9.0)
#define SF_NOISE_MEMORY ((sf_real)0.1)
#define SF_FIRST_MISFIT ((sf_real)4.0)
#define SF_LARGEST_MISFIT ((sf_real)25.0)
#define SF_MISFIT_MEMORY ((sf_real)0.06)
#define SF_CLIP ((sf_real)30.0)
#define SF_FIRST_WIDTH ((sf_real)8.0)
#define SF_LEAST ((sf_real)8.0)
#define SF_NEGLIGIBLE ((sf_real)1e-18) /* share of a mixture that changes no digit of it */
#define SF_SUSPICION ((sf_real)4.0)
#define SF_TRUST ((sf_real)10.0)
#define SF_WELL ((sf_real)0.5 * SF_SUSPICION)
#define SF_WAIT ((sf_real)6.0)
#define SF_CALM ((sf_real)0.4 * SF_SUSPICION)
#define SF_PATIENCE ((sf_real)10.0)
#define SF_RELIEF ((sf_real)0.4)
#define SF_CONTRAST ((sf_real)0.6)
#define SF_LOAD_CONTRAST ((sf_real)0.4)
#define SF_NOISE ((sf_real)1.0)
#define SF_LOAD_BLOCKS ((sf_real)3.0)
#define SF_LEAST_ERROR ((sf_real)0.1)
#define SF_LOSS ((sf_real)1.15)
#define SF_LIGHTER ((sf_real)0.02)

/* ------------------------------------------------------------------------------------------------ records */

/* All that is remembered: FrontState, MomentState and ChannelState side by side. */
typedef struct {
    sf_front front;
    sf_whole step;
    sf_real pending[SF_SPAN * SF_PENDING];
    sf_real mean[SF_UNKNOWNS], covariance[SF_UNKNOWNS * SF_UNKNOWNS];
    sf_real drift[SF_MAP], given[SF_UNKNOWNS], given_covariance[SF_MAP * SF_MAP];
    sf_real learnt[4 * SF_CHANNELS * SF_CHANNELS], spread[3 * SF_CHANNELS];
    sf_real kept_mean[2 * SF_UNKNOWNS], kept_covariance[SF_UNKNOWNS * (SF_UNKNOWNS + 1)];
    sf_real noise[SF_KINDS], misfit;
    sf_real rate, swing_zero[SF_CHANNELS], swing_ago[SF_FEET], swing_sum[SF_CHANNELS], swing_samples[SF_FEET];
    sf_real unproven, due, quiet, anchor[SF_CHANNELS];
    sf_whole status;
    sf_channel_faults faults;
    sf_real trust, doubt, scores[1 + SF_HYPOTHESES + 1], size[SF_HYPOTHESES], load[12];
} sf_state;

/* Some samples in a row, oldest first: those that wait, and which of them may be learnt from. */
typedef struct {
    const sf_real *pending;
    int width;
    sf_real use[SF_SPAN];
} sf_block;

/* Linear equations H x = y + e, e of these variances. */
typedef struct {
    int count;
    sf_real H[SF_ROWS * SF_UNKNOWNS], y[SF_ROWS], variance[SF_ROWS];
} sf_rows;

/* The rows of Newton and Euler: all groups of samples, whether they may be learnt from or not. */
typedef struct {
    sf_real H[SF_NEWTON * SF_UNKNOWNS], y[SF_NEWTON], variance[SF_NEWTON], assumed[SF_NEWTON];
    sf_real places[SF_NEWTON * SF_CHANNELS]; /* what a newton on each channel does, by its own place */
    sf_real residual[SF_NEWTON], spread[SF_NEWTON]; /* y - H x, and what it may be: the diagonal of H S H' + R */
    int there[SF_NEWTON], kept[SF_NEWTON]; /* rows that hold anything; those of them that are plausible */
    sf_real mean_square; /* mean squared normalised residual, each clipped */
} sf_newton;

/* Matrices on the way to an answer, of which nothing is remembered: of a Kalman step, of the severities, and of the
   block around both. */
typedef struct {
    sf_real HS[SF_ROWS * (SF_UNKNOWNS + 1)], V[SF_ROWS * SF_ROWS], gain[SF_UNKNOWNS * SF_ROWS];
    sf_real keep[SF_UNKNOWNS * SF_UNKNOWNS], kept[SF_UNKNOWNS * SF_UNKNOWNS];
} sf_kalman_work;

typedef struct {
    sf_real covariance[SF_MAP * SF_MAP];
    union {
        struct {
            sf_real axes[SF_MAP * SF_MAP], seen[SF_MAP * SF_MAP];
        } data;
        struct {
            sf_real own[4 * SF_SCALES * SF_SCALES], mixed[4 * SF_SCALES * SF_SCALES]; /* once those are used */
        } scales;
    } of;
    sf_real L[4 * SF_CHANNELS * SF_CHANNELS], W[4 * SF_CHANNELS * SF_SCALES], S[4 * SF_SCALES * SF_SCALES];
    sf_real found[16 * SF_MAP];
} sf_severity_work;

typedef struct {
    sf_newton newton;
    sf_rows rows;
    sf_real covariance[SF_UNKNOWNS * SF_UNKNOWNS];
    union {
        sf_kalman_work kalman;
        sf_severity_work severity;
    } part;
} sf_work;

/* Sizes of one robot that follow from others. */
SF_API int sf_scales(const sf_config *c) { return c->channels + c->talks; }
SF_API int sf_map(const sf_config *c) { return sf_scales(c) + c->channels; }
SF_API int sf_unknowns(const sf_config *c) { return sf_map(c) + 10; }
SF_API int sf_half(int rows) { return rows * (rows + 1) / 2; } /* of a symmetric matrix */
SF_API int sf_span(const sf_config *c) { return c->every + 2 * c->settle; }
SF_API int sf_width(const sf_config *c) { return 2 * c->channels + sf_motion(c) + c->feet + 2; }
SF_API int sf_groups(const sf_config *c) { return c->every / c->average; }
SF_API int sf_hypotheses(const sf_config *c) { return 2 * c->channels + 2 * c->pairs; }

/* Return whether it does with the moment filter; call it once for a config that comes from elsewhere. */
SF_API int sf_calibrator_fits(const sf_config *c) {
    int fits = sf_robot_fits(c) && c->average >= 1 && c->every >= c->average &&
               c->every <= SF_EVERY && c->every % c->average == 0 && sf_groups(c) <= SF_GROUPS &&
               c->settle >= 1 && c->settle <= SF_SETTLE && (c->kinds == 3 || c->kinds == 6) &&
               c->kinds <= SF_KINDS && c->sensors >= 0 && c->sensors <= SF_SENSORS && c->parities >= 0 &&
               c->parities <= SF_PARITIES && c->pairs >= 0 && c->pairs <= SF_PAIRS && c->keep_every >= 1 &&
               c->talks >= 0 && c->talks <= SF_TALKS;
    for (int t = 0; fits && t < c->talks; t++)
        fits = c->talk_to[t] >= 0 && c->talk_to[t] < c->channels && c->talk_from[t] >= 0 &&
               c->talk_from[t] < c->channels;
    for (int p = 0; fits && p < c->sensors; p++)
        fits = c->foot_of_sensor[p] >= 0 && c->foot_of_sensor[p] < c->feet;
    for (int p = 0; fits && p < c->pairs; p++)
        fits = c->first[p] >= 0 && c->first[p] < c->channels && c->second[p] >= 0 && c->second[p] < c->channels;
    return fits;
}

/* --------------------------------------------------------------------------------------- moment: unknowns */

/* Return r S r' for a symmetric S, shape (n, n). */
SF_API sf_real sf_variance(const sf_real *r, const sf_real *S, int n) {
    sf_real row[SF_UNKNOWNS] = {0};
    sf_add_rows(row, 1, r, 1, S, n, n, n);
    return sf_dot(row, r, n);
}

/* Unknowns.tared: F0 + o in N. */
SF_API sf_real sf_tared(const sf_config *c, const sf_real *mean, sf_real force, int i) {
    return force + mean[sf_scales(c) + i] * c->unit[i];
}

/* Unknowns.scaled: A f in N. */
SF_API void sf_scaled(const sf_config *c, const sf_real *mean, const sf_real *tared, sf_real *force) {
    for (int i = 0; i < c->channels; i++) force[i] = mean[i] * tared[i];
    for (int t = 0; t < c->talks; t++)
        force[c->talk_to[t]] += mean[c->channels + t] * tared[c->talk_from[t]];
}

/* Unknowns.force: A (F0 + o) in N. */
SF_API void sf_forces(const sf_config *c, const sf_real *mean, const sf_real *reading, sf_real *force) {
    sf_real tared[SF_CHANNELS];
    for (int i = 0; i < c->channels; i++) tared[i] = sf_tared(c, mean, reading[i], i);
    sf_scaled(c, mean, tared, force);
}

/* Unknowns.by_scale of one row, P numbers, times a weight, added. */
SF_API void sf_by_scale(const sf_config *c, sf_real weight, const sf_real *row, const sf_real *tared,
                        sf_real *out) {
    int K = c->channels;
    for (int k = 0; k < K; k++) out[k] += weight * (row[k] * tared[k]);
    for (int t = 0; t < c->talks; t++) out[K + t] += weight * (row[c->talk_to[t]] * tared[c->talk_from[t]]);
}

/* Unknowns.by_offset of one row, K numbers. */
SF_API void sf_by_offset(const sf_config *c, const sf_real *row, const sf_real *mean, sf_real *out) {
    int K = c->channels;
    for (int k = 0; k < K; k++) out[k] = row[k] * (mean[k] * c->unit[k]);
    for (int t = 0; t < c->talks; t++)
        out[c->talk_from[t]] += row[c->talk_to[t]] * (mean[K + t] * c->unit[c->talk_from[t]]);
}

/* What waits: places in one sample. */
SF_API const sf_real *sf_block_force(const sf_block *b, int t) { return b->pending + t * b->width; }
SF_API const sf_real *sf_block_motion(const sf_config *c, const sf_block *b, int t) {
    return b->pending + t * b->width + c->channels;
}
SF_API const sf_real *sf_block_read(const sf_config *c, const sf_block *b, int t) {
    return sf_block_motion(c, b, t) + sf_motion(c);
}
SF_API const sf_real *sf_block_swing(const sf_config *c, const sf_block *b, int t) {
    return sf_block_read(c, b, t) + c->channels;
}
SF_API sf_real sf_block_stand(const sf_config *c, const sf_block *b, int t) {
    return sf_block_swing(c, b, t)[c->feet];
}
SF_API sf_real sf_block_sound(const sf_config *c, const sf_block *b, int t) {
    return sf_block_swing(c, b, t)[c->feet + 1];
}

/* ----------------------------------------------------------------------------------------- moment: distal */

/* DistalMasses._wrenches: the wrench of each sensor's mass at its sole's origin in level axes, over n samples
   from `begin` on; `middle` is the sample whose rotations are taken. */
SF_API void sf_distal_wrenches(const sf_config *c, const sf_block *b, int begin, int n, const sf_real *curve,
                               sf_real *wrenches) {
    const sf_real *middle = sf_block_motion(c, b, begin + n / 2);
    sf_real mean[3] = {0, 0, 0};
    for (int t = begin; t < begin + n; t++)
        sf_add(mean, 1 / (sf_real)n, sf_block_motion(c, b, t) + SF_ACCELERATION, 3);
    for (int p = 0; p < c->sensors; p++) {
        int foot = c->foot_of_sensor[p];
        const sf_real *R = sf_rotation(c, middle, foot);
        sf_real *wrench = wrenches + 6 * p, sole[3] = {mean[0], mean[1], mean[2]}, arm[3];
        for (int t = 0; t < n; t++) {
            const sf_real *motion = sf_block_motion(c, b, begin + t), *at = sf_position(motion, foot);
            /* A level frame may move from sample to sample; distances to the centre of mass do not care. */
            for (int i = 0; i < 3; i++) sole[i] += (at[i] - motion[SF_COM + i]) * curve[t];
        }
        for (int i = 0; i < 3; i++)
            wrench[i] = c->sensor_mass[p] * (sole[i] + c->gravity * ((sf_real)(i == 2) - R[3 * i + 2]));
        sf_turn(arm, R, c->sensor_com + 3 * p);
        sf_cross(wrench + 3, arm, wrench);
    }
}

/* DistalMasses.total: what the feet's wrenches lack about the points below the centre of mass, over the middle. */
SF_API void sf_distal_total(const sf_config *c, const sf_block *b, sf_real *total) {
    sf_real wrenches[SF_SENSORS * 6];
    int begin = c->settle, n = c->every;
    sf_distal_wrenches(c, b, begin, n, c->curve_every, wrenches);
    const sf_real *middle = sf_block_motion(c, b, begin + n / 2);
    memset(total, 0, 6 * sizeof(sf_real));
    for (int p = 0; p < c->sensors; p++) {
        int foot = c->foot_of_sensor[p];
        const sf_real *R = sf_rotation(c, middle, foot);
        sf_real arm[3] = {0, 0, 0}, own[3], part[6], moment[3];
        for (int t = begin; t < begin + n; t++) {
            const sf_real *motion = sf_block_motion(c, b, t), *at = sf_position(motion, foot);
            arm[0] += (at[0] - motion[SF_COM]) / n;
            arm[1] += (at[1] - motion[SF_COM + 1]) / n;
            arm[2] += (at[2] - sf_ground_height(c, motion)) / n;
        }
        /* A sensor lacks nothing along the axes of the sole that it does not measure. */
        for (int half = 0; half < 2; half++) {
            sf_turn_back(own, R, wrenches + 6 * p + 3 * half);
            for (int i = 0; i < 3; i++) own[i] *= c->sensor_share[6 * p + 3 * half + i];
            sf_turn(part + 3 * half, R, own);
        }
        sf_cross(moment, arm, part);
        for (int i = 0; i < 3; i++) {
            total[i] += part[i];
            total[3 + i] += part[3 + i] + moment[i];
        }
    }
}

/* DistalMasses.felt: what each channel reads of it while nothing touches its foot. */
SF_API void sf_distal_felt(const sf_config *c, const sf_block *b, sf_real *felt) {
    sf_real wrenches[SF_SENSORS * 6], own[6];
    int n = sf_span(c), K = c->channels;
    sf_distal_wrenches(c, b, 0, n, c->curve_span, wrenches);
    const sf_real *middle = sf_block_motion(c, b, n / 2);
    memset(felt, 0, (size_t)K * sizeof(sf_real));
    for (int p = 0; p < c->sensors; p++) {
        const sf_real *R = sf_rotation(c, middle, c->foot_of_sensor[p]);
        sf_turn_back(own, R, wrenches + 6 * p);
        sf_turn_back(own + 3, R, wrenches + 6 * p + 3);
        for (int i = 0; i < 6; i++) sf_add(felt, own[i], c->felt + (6 * p + i) * K, K);
    }
}

/* ----------------------------------------------------------------------------------- moment: newton_euler */

/* Add the level wrenches of both feet about the point below the centre of mass, by channel: the rows that are
   seen, in body weights (times foot lengths), shape (kinds, K). */
SF_API void sf_wrench_rows(const sf_config *c, const sf_real *motion, sf_real *rows) {
    int K = c->channels, skip = c->kinds == 6 ? SF_FX : SF_FZ;
    sf_real ground = sf_ground_height(c, motion);
    for (int i = 0; i < K; i++) {
        int foot = c->foot_of_channel[i];
        const sf_real *R = sf_rotation(c, motion, foot), *at = sf_position(motion, foot);
        const sf_real *map = c->wrench_map + foot * 6 * K + i;
        sf_real force[3] = {map[0], map[K], map[2 * K]}, torque[3] = {map[3 * K], map[4 * K], map[5 * K]};
        sf_real arm[3] = {at[0] - motion[SF_COM], at[1] - motion[SF_COM + 1], at[2] - ground};
        sf_real wrench[6], own[3], moment[3];
        sf_turn(wrench, R, force);
        sf_turn(own, R, torque);
        sf_cross(moment, arm, wrench);
        for (int axis = 0; axis < 3; axis++) wrench[3 + axis] = own[axis] + moment[axis];
        for (int kind = 0; kind < c->kinds; kind++)
            rows[kind * K + i] = wrench[skip + kind] * c->row_scale[kind];
    }
}

/* NewtonEuler._asked: the wrench that the motion asks for, below the centre of mass, shape (kinds,). */
SF_API void sf_asked(const sf_config *c, const sf_real *motion, sf_real height, sf_real *asked) {
    const sf_real *acceleration = motion + SF_ACCELERATION, *rate = motion + SF_RATE;
    sf_real lever = c->weight * c->length, x = acceleration[0] / c->gravity, y = acceleration[1] / c->gravity;
    int six = c->kinds == 6;
    sf_real *three = asked + (six ? 2 : 0);
    three[0] = acceleration[2] / c->gravity + 1;
    three[1] = rate[0] / lever - height * y;
    three[2] = rate[1] / lever + height * x;
    if (six) {
        asked[0] = x;
        asked[1] = y;
        asked[5] = rate[2] / lever;
    }
}

/* NewtonEuler._to_cop: move the moments among some rows, shape (kinds, columns), to (x, y) ahead. */
SF_API void sf_to_cop_rows(const sf_config *c, sf_real *rows, int columns, sf_real x, sf_real y) {
    int six = c->kinds == 6;
    const sf_real *fz = rows + (six ? SF_FZ : 0) * columns;
    sf_real *mx = rows + (six ? SF_MX : 1) * columns, *my = rows + (six ? SF_MY : 2) * columns;
    sf_add(mx, -y, fz, columns);
    sf_add(my, x, fz, columns);
    if (six) {
        sf_add(rows + SF_MZ * columns, -x, rows + SF_FY * columns, columns);
        sf_add(rows + SF_MZ * columns, y, rows + SF_FX * columns, columns);
    }
}

/* NewtonEuler._error_columns: those of the reference's own errors into columns `at` and behind, of width N. */
SF_API void sf_error_columns(const sf_config *c, const sf_real *given, const sf_real *apart, sf_real height,
                             const sf_real *late, const sf_real *of_blur, sf_real *H, int at, int N) {
    int six = c->kinds == 6, fz = six ? SF_FZ : 0;
    for (int kind = 0; kind < c->kinds; kind++) {
        int axis = six ? kind : SF_FZ + kind;
        sf_real *row = H + kind * N + at;
        /* A point that is off by d sees the moment d x f besides. */
        row[0] = axis == SF_MY ? -given[fz] : axis == SF_MZ ? given[SF_FY] : 0;
        row[1] = axis == SF_MX ? given[fz] : axis == SF_MZ ? -given[SF_FX] : 0;
        row[2] = given[kind];
        row[3] = axis == SF_FX ? 1 : axis == SF_MY ? height : 0;
        row[4] = axis == SF_FY ? 1 : axis == SF_MX ? -height : 0;
        row[5] = axis == SF_FZ ? 1 : 0;
        row[6] = late[kind];
        row[7] = axis == SF_MY ? -apart[fz] : axis == SF_MZ ? apart[SF_FY] : 0;
        row[8] = axis == SF_MX ? apart[fz] : axis == SF_MZ ? -apart[SF_FX] : 0;
        row[9] = of_blur[kind];
    }
}

/* NewtonEuler._blurred: the forces of one sample, averaged as the reference averages its rates, and what they change
   with the window's variance in squared samples. */
SF_API void sf_blurred(const sf_config *c, const sf_block *b, int t, int passes, sf_real blur, sf_real *blurred,
                       sf_real *change) {
    int K = c->channels;
    sf_real force[(2 * SF_PASSES + 1) * SF_CHANNELS], bend[(2 * SF_PASSES - 1) * SF_CHANNELS];
    sf_real weight = blur / (sf_real)(2 * passes);
    for (int i = 0; i <= 2 * passes; i++) sf_copy(force + i * K, sf_block_force(b, t - passes + i), K);
    for (int left = 2 * passes - 1; left > 0; left -= 2)
        for (int i = 0; i < left * K; i++) {
            bend[i] = force[i + 2 * K] - 2 * force[i + K] + force[i];
            force[i] = force[i + K] + weight * bend[i];
        }
    sf_copy(blurred, force, K);
    for (int k = 0; k < K; k++) change[k] = bend[k] / 2;
}

/* NewtonEuler.rows: what the motion asks of the ground, about the estimated centre of pressure. */
SF_API void sf_newton_euler_rows(const sf_config *c, const sf_state *s, const sf_block *b, sf_newton *out) {
    int K = c->channels, P = sf_scales(c), M = sf_map(c), N = sf_unknowns(c), kinds = c->kinds, settle = c->settle,
        first = kinds == 6 ? 0 : SF_FZ, passes = settle < SF_PASSES ? settle : SF_PASSES;
    const sf_real *mean = s->mean;
    sf_real blur = sf_min(sf_max(mean[M + 9], 0), (sf_real)passes / 2);
    sf_real lacking[6] = {0, 0, 0, 0, 0, 0};
    if (c->distal_matters) sf_distal_total(c, b, lacking);
    for (int group = 0; group < sf_groups(c); group++) {
        sf_real *H = out->H + group * kinds * N, *y = out->y + group * kinds;
        sf_real *variance = out->variance + group * kinds, *places = out->places + group * kinds * K;
        sf_real use[SF_EVERY], count = 0, height = 0, rows[SF_KINDS * SF_CHANNELS], own[SF_KINDS * SF_CHANNELS];
        sf_real of_rows[SF_KINDS * SF_CHANNELS] = {0}, of_speed[SF_KINDS * SF_CHANNELS] = {0}, late[SF_KINDS] = {0};
        sf_real asked[SF_KINDS] = {0}, of_blur[SF_KINDS] = {0}, given[SF_KINDS], apart[SF_KINDS], part[SF_KINDS];
        sf_real change[SF_CHANNELS], tared[SF_CHANNELS], blurred[SF_CHANNELS], other[SF_CHANNELS];
        memset(H, 0, (size_t)(kinds * N) * sizeof(sf_real));
        memset(y, 0, (size_t)kinds * sizeof(sf_real));
        memset(places, 0, (size_t)(kinds * K) * sizeof(sf_real));
        for (int kind = 0; kind < kinds; kind++) variance[kind] = c->row_variance[kind] * s->noise[kind];
        for (int i = 0; i < c->average; i++) {
            int t = settle + group * c->average + i;
            const sf_real *motion = sf_block_motion(c, b, t);
            use[i] = sf_block_stand(c, b, t);
            for (int j = t - settle; j <= t + settle; j++) use[i] *= b->use[j];
            count += use[i];
            height += (motion[SF_COM + 2] - sf_ground_height(c, motion)) / c->length / c->average;
        }
        if (!(count > (sf_real)0.5)) continue; /* rows of zeros */
        for (int i = 0; i < c->average; i++) {
            if (use[i] == 0) continue;
            int t = settle + group * c->average + i;
            const sf_real *motion = sf_block_motion(c, b, t);
            const sf_real *ahead = sf_block_force(b, t + settle), *behind = sf_block_force(b, t - settle);
            sf_real weight = use[i] / count;
            sf_real *seen = s->faults.altered ? own : rows;
            sf_wrench_rows(c, motion, seen);
            if (s->faults.altered) sf_multiply(rows, own, s->faults.spare, kinds, K, K);
            /* How fast the forces change in N/s, without what no reference could follow. */
            sf_forces(c, mean, ahead, change);
            sf_forces(c, mean, behind, other);
            for (int k = 0; k < K; k++) change[k] = (change[k] - other[k]) / (2 * settle * c->dt);
            sf_blurred(c, b, t, passes, blur, tared, other);
            for (int k = 0; k < K; k++) tared[k] = sf_tared(c, mean, tared[k], k);
            sf_scaled(c, mean, other, blurred);
            sf_asked(c, motion, (motion[SF_COM + 2] - sf_ground_height(c, motion)) / c->length, part);
            for (int kind = 0; kind < kinds; kind++) {
                const sf_real *row = rows + kind * K;
                asked[kind] += weight * part[kind];
                of_blur[kind] += weight * sf_dot(row, blurred, K);
                sf_by_scale(c, weight, row, tared, H + kind * N);
                for (int k = 0; k < K; k++) {
                    sf_real speed = row[k] * change[k];
                    of_rows[kind * K + k] += weight * row[k];
                    of_speed[kind * K + k] += weight * speed;
                    late[kind] += weight * speed;
                }
            }
            if (s->faults.altered) sf_add(places, weight, own, kinds * K);
        }
        if (!s->faults.altered) sf_copy(places, of_rows, kinds * K);
        for (int kind = 0; kind < kinds; kind++) {
            sf_real *row = H + kind * N;
            sf_by_offset(c, of_rows + kind * K, mean, row + P);
            given[kind] = sf_dot(row, mean, P);
            apart[kind] = 0;
            for (int k = 0; c->feet > 1 && k < P; k++) {
                int channel = k < K ? k : c->talk_to[k - K];
                apart[kind] += (c->foot_of_channel[channel] ? -1 : 1) * (row[k] * mean[k]);
            }
            /* The forces are products of scales and tared readings: H x counts what the offsets do twice. */
            y[kind] = asked[kind] - lacking[first + kind] * c->row_scale[kind] + sf_dot(row + P, mean + P, K) +
                      of_blur[kind] * blur;
        }
        sf_error_columns(c, given, apart, height, late, of_blur, H, M, N);
        int fz = kinds == 6 ? SF_FZ : 0;
        sf_real load = given[fz] > SF_LEAST_LOAD ? given[fz] : SF_LEAST_LOAD;
        sf_real x = -given[fz + 2] / load, ahead_y = given[fz + 1] / load;
        sf_to_cop_rows(c, H, N, x, ahead_y);
        /* The way there has the reference's noise in it: the column of the vertical bias is not moved. */
        for (int kind = 0; kind < kinds; kind++) H[kind * N + M + 5] = kind == fz;
        sf_to_cop_rows(c, y, 1, x, ahead_y);
        sf_to_cop_rows(c, of_speed, K, x, ahead_y);
        sf_to_cop_rows(c, places, K, x, ahead_y);
        for (int kind = 0; kind < kinds; kind++) {
            const sf_real *jitter = of_speed + kind * K;
            variance[kind] += c->timing_noise * c->timing_noise / c->average * sf_dot(jitter, jitter, K);
            for (int k = 0; s->faults.altered && k < K; k++) {
                sf_real unsure = places[kind * K + k] * s->faults.spare_std[k];
                variance[kind] += unsure * unsure;
            }
        }
    }
}

/* NewtonEuler.readings: the mean forces by the starting map that belong to each group, shape (groups, K). */
SF_API void sf_readings(const sf_config *c, const sf_block *b, sf_real *reading) {
    int K = c->channels;
    memset(reading, 0, (size_t)(sf_groups(c) * K) * sizeof(sf_real));
    for (int i = 0; i < c->every; i++)
        sf_add(reading + i / c->average * K, 1, sf_block_force(b, c->settle + i), K);
    for (int i = 0; i < sf_groups(c) * K; i++) reading[i] /= (sf_real)c->average;
}

/* ----------------------------------------------------------------------------------- moment: tare, parity */

/* Tare._landed: which feet already carry weight where they should swing still. */
SF_API void sf_landed(const sf_config *c, const sf_state *s, const sf_block *b, unsigned char *landed) {
    int K = c->channels, n = sf_span(c);
    sf_real up[SF_CHANNELS], force[SF_CHANNELS], load[SF_SPAN];
    for (int foot = 0; foot < c->feet; foot++) {
        const sf_real *vertical = c->wrench_map + (foot * 6 + SF_FZ) * K;
        sf_real least = 0;
        int any = 0;
        if (s->faults.altered) sf_multiply(up, vertical, s->faults.spare, 1, K, K);
        else sf_copy(up, vertical, K);
        for (int t = 0; t < n; t++) {
            sf_forces(c, s->mean, sf_block_force(b, t), force);
            load[t] = sf_dot(up, force, K) / c->weight;
            if (sf_block_swing(c, b, t)[foot] > (sf_real)0.5) {
                least = any ? sf_min(least, load[t]) : load[t];
                any = 1;
            }
        }
        for (int t = 0; t < n; t++) landed[t * c->feet + foot] = load[t] > least + c->swing_load;
    }
}

/* Tare.hanging: mean readings while feet surely hang, and how many samples of each foot count. */
SF_API void sf_hanging(const sf_config *c, const sf_state *s, const sf_block *b, sf_real *count, sf_real *reading) {
    int K = c->channels;
    unsigned char landed[SF_SPAN * SF_FEET];
    memset(count, 0, (size_t)c->feet * sizeof(sf_real));
    memset(reading, 0, (size_t)K * sizeof(sf_real));
    sf_landed(c, s, b, landed);
    for (int i = 0; i < c->every; i++)
        for (int foot = 0; foot < c->feet; foot++) {
            sf_real sure = b->use[c->settle + i];
            for (int at = i; at <= i + 2 * c->settle; at++)
                sure *= landed[at * c->feet + foot] ? 0 : sf_block_swing(c, b, at)[foot];
            count[foot] += sure;
            for (int k = 0; sure != 0 && k < K; k++)
                if (c->foot_of_channel[k] == foot) reading[k] += sf_block_force(b, c->settle + i)[k];
        }
    for (int k = 0; k < K; k++) {
        sf_real number = count[c->foot_of_channel[k]];
        reading[k] /= number > (sf_real)0.5 ? number : 1;
    }
}

/* Tare.rows: the offset of a channel that its mean reading in the air shows. */
SF_API sf_real sf_hung(const sf_config *c, const sf_state *s, const sf_real *reading, const sf_real *felt, int k) {
    sf_real shown = -reading[k] / c->unit[k];
    return c->distal_matters ? shown + felt[k] / (c->unit[k] * s->mean[k]) : shown;
}

/* Tare.variance: that of a mean reading over so many samples. */
SF_API sf_real sf_tare_variance(const sf_config *c, sf_real number) {
    return c->swing_noise * c->swing_noise * SF_SWING_SAMPLES / sf_max(number, 1);
}

/* ErrorProduct.forgotten, with noise and trust: forget what a foot was learnt with offsets that its first swing
   proves wrong. */
SF_API void sf_begin_anew(const sf_config *c, sf_state *s, const sf_real *count, const sf_real *reading,
                          const sf_real *felt) {
    int K = c->channels, P = sf_scales(c), N = sf_unknowns(c), wrong[SF_FEET] = {0}, any = 0;
    for (int k = 0; k < K; k++) {
        int foot = c->foot_of_channel[k];
        if (!(count[foot] > (sf_real)0.5 && s->swing_ago[foot] < 0 && s->swing_samples[foot] < (sf_real)0.5) ||
            s->faults.lost[k] != 0)
            continue;
        if (sf_fabs(sf_hung(c, s, reading, felt, k) - s->mean[P + k]) >
            SF_WRONG + SF_SURE_STD * sf_sqrt(sf_tare_variance(c, count[foot])))
            any = wrong[foot] = 1;
    }
    if (!any) return;
    for (int state = 0; state < 3; state++) {
        sf_real *mean = state == 0 ? s->mean : s->kept_mean + (state - 1) * N;
        sf_real *kept = state == 0 ? s->covariance : s->kept_covariance + (state - 1) * sf_half(N);
        for (int i = 0; i < P + K; i++) {
            if (!wrong[c->foot_of_channel[i < K ? i : i < P ? c->talk_from[i - K] : i - P]]) continue;
            mean[i] = c->start[i];
            for (int k = 0; k < N; k++) {
                sf_real known = k == i ? c->first_variance[i] : 0;
                if (state == 0) kept[i * N + k] = kept[k * N + i] = known;
                else kept[k < i ? sf_half(i) + k : sf_half(k) + i] = known;
            }
        }
    }
    for (int kind = 0; kind < c->kinds; kind++) s->noise[kind] = SF_FIRST_NOISE;
    s->trust = 0;
}

/* MomentStream._hanging and the rows of _tared: the tare of feet that hang, unless they carry
   weight; returns whether any does. Gives the samples of each foot that count, and the mean readings over them. */
SF_API int sf_tare(const sf_config *c, sf_state *s, const sf_block *b, sf_rows *rows, sf_real *count,
                   sf_real *reading) {
    int K = c->channels, P = sf_scales(c), M = sf_map(c), N = sf_unknowns(c), any = 0, all = 1;
    sf_real felt[SF_CHANNELS] = {0}, up[SF_CHANNELS], tared[SF_CHANNELS];
    sf_hanging(c, s, b, count, reading);
    for (int foot = 0; foot < c->feet; foot++) all = all && count[foot] > (sf_real)0.5;
    for (int foot = 0; foot < c->feet; foot++) {
        const sf_real *vertical = c->wrench_map + (foot * 6 + SF_FZ) * K;
        if (s->faults.altered) sf_multiply(up, vertical, s->faults.spare, 1, K, K);
        else sf_copy(up, vertical, K);
        sf_real stated = 0, known = 0, row[SF_MAP] = {0}, load;
        /* What was learnt before a first swing was learnt with offsets that nobody knew. */
        int unseen = s->swing_ago[foot] < 0 && s->swing_samples[foot] < (sf_real)0.5;
        const sf_real *mean = unseen ? c->start : s->mean;
        for (int k = 0; k < K; k++) {
            up[k] /= c->weight;
            tared[k] = sf_tared(c, mean, reading[k], k);
        }
        sf_by_scale(c, 1, up, tared, row);
        sf_by_offset(c, up, mean, row + P);
        load = sf_dot(row, mean, P);
        for (int k = 0; k < M; k++) {
            stated += row[k] * row[k] * (c->stated[k] + s->drift[k]);
            known += row[k] * sf_dot(s->covariance + k * N, row, M);
        }
        sf_real limit = c->swing_load + SF_LOAD_STD * sf_sqrt(sf_max(known < stated && !unseen ? known : stated, 0));
        /* Not all feet of a robot that stands are in the air. */
        if ((count[foot] > (sf_real)0.5 && sf_fabs(load) > limit) || all) {
            any = 1;
            count[foot] = 0;
        }
    }
    if (c->distal_matters) sf_distal_felt(c, b, felt);
    sf_begin_anew(c, s, count, reading, felt);
    for (int k = 0; k < K; k++) {
        sf_real number = count[c->foot_of_channel[k]];
        if (!(number > (sf_real)0.5) || (s->faults.altered && s->faults.lost[k] != 0)) continue;
        int at = rows->count++;
        memset(rows->H + at * N, 0, (size_t)N * sizeof(sf_real));
        rows->H[at * N + P + k] = 1;
        rows->y[at] = sf_hung(c, s, reading, felt, k);
        rows->variance[at] = sf_tare_variance(c, number);
    }
    return any;
}

/* ------------------------------------------------------------------------------------------ moment: drift */

/* LearntDrift.walk: the variances by which the unknowns drift in one block. */
SF_API void sf_walk(const sf_config *c, const sf_state *s, sf_real *walk) {
    int K = c->channels, P = sf_scales(c), N = sf_unknowns(c);
    sf_copy(walk, c->walk, N);
    for (int i = 0; i < K; i++) {
        sf_real square = sf_clip(s->mean[i], 1, SF_LARGEST_SCALE);
        square *= square;
        walk[i] *= s->rate * (square * square);
        walk[P + i] *= s->rate;
    }
}

/* LearntDrift.followed: the rate that swings show which end with this block. */
SF_API void sf_drift_followed(const sf_config *c, sf_state *s, const sf_real *count, const sf_real *reading) {
    int K = c->channels, P = sf_scales(c);
    sf_real total = 0;
    for (int foot = 0; foot < c->feet; foot++) {
        sf_real number = sf_max(s->swing_samples[foot], 1), channels = 0, common = 0, surplus = 0;
        /* The first swing is the first however short it was. */
        sf_real least = s->swing_ago[foot] < 0 ? (sf_real)0.5 : SF_FEWEST_SAMPLES - (sf_real)0.5;
        int air = count[foot] > (sf_real)0.5, ends = !air && s->swing_samples[foot] > least;
        for (int k = 0; k < K; k++) {
            if (c->foot_of_channel[k] != foot || s->faults.lost[k] != 0) continue;
            channels += 1;
            common += s->swing_sum[k] / number - s->swing_zero[k];
        }
        common /= sf_max(channels, 1);
        for (int k = 0; k < K; k++) {
            if (c->foot_of_channel[k] != foot) continue;
            sf_real moved = s->swing_sum[k] / number - s->swing_zero[k] - common;
            sf_real expected = s->rate * c->walk[P + k] * s->swing_ago[foot] + 2 * sf_tare_variance(c, number);
            expected *= 1 - 1 / sf_max(channels, 1);
            if (s->faults.lost[k] == 0)
                surplus += sf_clip(moved * moved / (expected > 0 ? expected : 1), 0, SF_LARGEST_SQUARE) - 1;
            if (ends) s->swing_zero[k] = s->swing_sum[k] / number;
            s->swing_sum[k] = air ? s->swing_sum[k] + reading[k] / c->unit[k] * count[foot] : 0;
        }
        if (ends && s->swing_ago[foot] > 0 && channels > SF_FEWEST_CHANNELS) total += surplus / channels;
        if (ends) s->swing_ago[foot] = 0;
        s->swing_samples[foot] = air ? s->swing_samples[foot] + count[foot] : 0;
    }
    s->rate = sf_clip(s->rate * (1 + SF_RATE_MEMORY * total), 1, SF_FASTEST);
}

/* Parity.rows: append that the instruments of one foot measure the same wrench, for each half of the block. */
SF_API void sf_parity_rows(const sf_config *c, const sf_state *s, const sf_block *b, sf_rows *rows) {
    int K = c->channels, P = sf_scales(c), N = sf_unknowns(c), half = c->every / 2;
    sf_real felt[SF_CHANNELS] = {0};
    if (c->distal_matters) sf_distal_felt(c, b, felt);
    for (int part = 0; part < 2; part++) {
        int begin = c->settle + part * half, known = 1;
        sf_real reading[SF_CHANNELS] = {0};
        for (int t = begin; t < begin + half; t++) {
            known = known && b->use[t] > (sf_real)0.5;
            sf_add(reading, 1 / (sf_real)half, sf_block_force(b, t), K);
        }
        for (int k = 0; k < K; k++) reading[k] = sf_tared(c, s->mean, reading[k], k);
        for (int p = 0; known && p < c->parities; p++) {
            const sf_real *parity = c->parity + p * K;
            int at = rows->count++;
            sf_real *H = rows->H + at * N;
            memset(H, 0, (size_t)N * sizeof(sf_real));
            sf_by_scale(c, 1, parity, reading, H);
            sf_by_offset(c, parity, s->mean, H + P);
            rows->y[at] = sf_dot(felt, parity, K) + sf_dot(H + P, s->mean + P, K);
            rows->variance[at] = c->parity_noise * c->parity_noise;
        }
    }
}

/* ----------------------------------------------------------------------------------------- moment: kalman */

/* kalman_step: take in all rows at once, in place; returns whether the result is finite.

   K = S H' (H S H' + R)^-1,    x <- x + K (y - H x),    S <- (1 - K H) S (1 - K H)' + K R K'

   Joseph's form holds for any gain, also with zeros for unknowns that are only considered (Schmidt), and stays
   positive in single precision. A row whose innovation is beyond the gate has its variance raised until it is not. */
SF_API int sf_kalman_step(sf_real *mean, sf_real *S, sf_rows *rows, const sf_real *learnt, int N,
                          sf_real gate, sf_kalman_work *w, sf_real *nis, sf_real *nis_rows) {
    int m = rows->count, wide = N + 1;
    sf_real e[SF_ROWS], weighted[SF_ROWS], *HS = w->HS, *V = w->V, *gain = w->gain, *keep = w->keep, *kept = w->kept;
    *nis = *nis_rows = 0;
    if (m == 0) return 1;
    /* Of gain and keep the transposed: all products are sums of rows then. Until there is a gain, H' is there. */
    for (int i = 0; i < m; i++)
        for (int k = 0; k < N; k++) gain[k * m + i] = rows->H[i * N + k];
    memset(HS, 0, (size_t)(m * wide) * sizeof(sf_real));
    memset(V, 0, (size_t)(m * m) * sizeof(sf_real));
    for (int i = 0; i < m; i++) {
        const sf_real *H = rows->H + i * N;
        sf_real *row = HS + i * wide;
        sf_add_rows(row, 1, H, 1, S, N, N, N);
        row[N] = e[i] = rows->y[i] - sf_dot(H, mean, N);
        sf_add_rows(V + i * m, 1, row, 1, gain, m, N, i + 1);
        sf_real predicted = V[i * m + i], needed = e[i] * e[i] / (gate * gate) - predicted;
        *nis_rows += predicted > 0;
        if (needed > rows->variance[i]) rows->variance[i] = needed;
        V[i * m + i] += rows->variance[i];
    }
    if (!sf_cholesky(V, m)) return 0;
    sf_solve(V, m, HS, wide);
    for (int i = 0; i < m; i++) {
        *nis += e[i] * HS[i * wide + N];
        for (int k = 0; k < N; k++) gain[i * N + k] = HS[i * wide + k] * learnt[k];
    }
    sf_add_rows(mean, 1, e, 1, gain, N, m, N);
    memset(keep, 0, (size_t)(N * N) * sizeof(sf_real));
    for (int k = 0; k < N; k++) {
        keep[k * N + k] = 1;
        sf_add_rows(keep + k * N, -1, rows->H + k, N, gain, N, m, N);
    }
    /* keep is mostly zeros where few unknowns are seen, as by feet that hang: its numbers are the factors. */
    memset(kept, 0, (size_t)(N * N) * sizeof(sf_real));
    for (int i = 0; i < N; i++) sf_add_rows(kept + i * N, 1, keep + i, N, S, N, N, N);
    memset(S, 0, (size_t)(N * N) * sizeof(sf_real));
    for (int i = 0; i < N; i++) {
        for (int j = 0; j < m; j++) weighted[j] = gain[j * N + i] * rows->variance[j];
        sf_add_rows(S + i * N, 1, kept + i * N, 1, keep, N, N, i + 1);
        sf_add_rows(S + i * N, 1, weighted, 1, gain, N, m, i + 1);
        for (int j = 0; j < i; j++) S[j * N + i] = S[i * N + j];
    }
    return sf_all_finite(mean, N) && sf_all_finite(S, N * N);
}

/* -------------------------------------------------------------------------- moment: severity, uncertainty */

/* Four matrices at once, as none of their numbers wait for another's: number k of all four is at 4 * k and behind. */

/* out -= a b */
SF_API void sf_less_four(sf_real *__restrict out, const sf_real *a, const sf_real *b) {
    for (int l = 0; l < 4; l++) out[l] -= a[l] * b[l];
}

/* sf_cholesky of four, and the logarithms of their determinants, NaN of those that are not positive definite. */
SF_API void sf_cholesky_four(sf_real *A, int n, sf_real size[4]) {
    sf_real by[4], product[4] = {1, 1, 1, 1};
    for (int l = 0; l < 4; l++) size[l] = 0;
    for (int i = 0; i < n; i++) {
        for (int j = i; j < n; j++) {
            sf_real *out = A + 4 * (j * n + i), sum[4] = {out[0], out[1], out[2], out[3]};
            for (int k = 0; k < i; k++) sf_less_four(sum, A + 4 * (j * n + k), A + 4 * (i * n + k));
            for (int l = 0; j == i && l < 4; l++) by[l] = 1 / sf_sqrt(sum[l] > 0 ? sum[l] : (sf_real)NAN);
            for (int l = 0; l < 4; l++) out[l] = sum[l] * by[l];
        }
        for (int l = 0; l < 4; l++) {
            product[l] *= A[4 * (i * n + i) + l];
            if (i % 4 == 3 || i == n - 1) size[l] += 2 * sf_log(product[l]), product[l] = 1;
        }
    }
}

/* Overwrite four B, shape (n, columns), with L^-1 B, or with L'^-1 B. */
SF_API void sf_solve_four(const sf_real *L, int n, sf_real *B, int columns, int upper) {
    for (int step = 0; step < n; step++) {
        int i = upper ? n - 1 - step : step, first = upper ? i + 1 : 0, last = upper ? n : i;
        sf_real by[4];
        for (int l = 0; l < 4; l++) by[l] = 1 / L[4 * (i * n + i) + l];
        for (int j = 0; j < columns; j++) {
            sf_real *out = B + 4 * (i * columns + j), sum[4] = {out[0], out[1], out[2], out[3]};
            for (int k = first; k < last; k++)
                sf_less_four(sum, L + 4 * (upper ? k * n + i : i * n + k), B + 4 * (k * columns + j));
            for (int l = 0; l < 4; l++) out[l] = sum[l] * by[l];
        }
    }
}

/* Overwrite the factors of four with the lower halves of the inverses: L^-1 in place, then its square. */
SF_API void sf_inverse_four(sf_real *L, int n) {
    for (int i = 0; i < n; i++) {
        sf_real own[4];
        for (int l = 0; l < 4; l++) own[l] = 1 / L[4 * (i * n + i) + l];
        for (int j = 0; j < i; j++) {
            sf_real sum[4] = {0, 0, 0, 0};
            for (int k = j; k < i; k++) sf_less_four(sum, L + 4 * (i * n + k), L + 4 * (k * n + j));
            for (int l = 0; l < 4; l++) L[4 * (i * n + j) + l] = own[l] * sum[l];
        }
        memcpy(L + 4 * (i * n + i), own, sizeof own);
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            sf_real sum[4] = {0, 0, 0, 0}, *out = L + 4 * (i * n + j);
            for (int k = i; k < n; k++) sf_less_four(sum, L + 4 * (k * n + i), L + 4 * (k * n + j));
            for (int l = 0; l < 4; l++) out[l] = -sum[l];
        }
}

/* Factors of four precisions of scales with the prior of a severity; `size` is as of sf_cholesky_four. */
SF_API void sf_with_prior(sf_real *out, const sf_real *precision, const sf_real *ratio, sf_real severity, int P,
                          sf_real size[4]) {
    sf_copy(out, precision, 4 * P * P);
    for (int i = 0; i < P; i++)
        for (int l = 0; l < 4; l++) out[4 * (i * P + i) + l] += 1 / (severity * severity * ratio[i]);
    sf_cholesky_four(out, P, size);
}

/* LearntSeverity.reweighted: scales and offsets under all severities together, and in `w` their
   covariance, shape (M, M); returns 0 if there is no answer.

   Severities are of all scales and of all offsets; those of offsets are side by side. With the information of the data
   A, B and C about scales, both and offsets, and the priors' s and o, what all severities of scales share is done once:
   W = (C + o)^-1 B' and S = A - B W, so that

       V = [(S + s)^-1, -(S + s)^-1 W'; -W (S + s)^-1, (C + o)^-1 + W (S + s)^-1 W']. */
SF_API int sf_reweighted(const sf_config *c, const sf_state *s, sf_severity_work *w, sf_real *mean) {
    static const sf_real severities[4] = {(sf_real)0.04, (sf_real)0.2, 1, 5};
    static const sf_real likely[4] = {(sf_real)0.1, (sf_real)0.1, (sf_real)0.7, (sf_real)0.1};
    int K = c->channels, P = sf_scales(c), M = sf_map(c), N = sf_unknowns(c);
    sf_real std[SF_MAP], ratio[SF_MAP], share[SF_MAP], off[SF_MAP], pull[SF_MAP], factor[SF_MAP];
    sf_real z[4 * SF_CHANNELS], x[4 * SF_SCALES], answer[4 * SF_MAP], of_offsets[4], of_scales[4], wide[4], odds[4];
    sf_real *covariance = w->covariance, *axes = w->of.data.axes, *seen = w->of.data.seen, *L = w->L, *W = w->W;
    sf_real *S = w->S, *own = w->of.scales.own, *mixed = w->of.scales.mixed, *found = w->found;
    sf_real evidence[16], weight[4] = {0, 0, 0, 0}, best = -HUGE_VAL, total = 0, constant = 0;
    for (int i = 0; i < M; i++) {
        sf_real stated = c->stated[i] + s->drift[i],
                prior = SF_FIRST_WIDTH * SF_FIRST_WIDTH * c->stated[i] + s->drift[i];
        std[i] = sf_sqrt(prior);
        ratio[i] = stated / prior;
        constant += sf_log(ratio[i]);
        off[i] = (s->mean[i] - c->start[i]) / std[i];
        pull[i] = 0;
    }
    for (int i = 0; i < M; i++)
        for (int j = 0; j < M; j++) covariance[i * M + j] = s->covariance[i * N + j] / (std[i] * std[j]);
    if (!sf_eigen(covariance, M, share, axes, found)) return 0;

    /* The information of the data alone, P^-1 - P0^-1, in units of the prior that the filter began with. */
    sf_real worth = 1 / sf_max(s->misfit, 1);
    for (int k = 0; k < M; k++) {
        share[k] = sf_clip(share[k], SF_LEAST * SF_EPSILON, 1);
        sf_add(pull, sf_dot(axes + k * M, off, M) * (worth / share[k]), axes + k * M, M);
    }
    memset(seen, 0, (size_t)(M * M) * sizeof(sf_real));
    for (int i = 0; i < M; i++) {
        for (int k = 0; k < M; k++) factor[k] = worth * (1 / share[k] - 1) * axes[k * M + i];
        sf_add_rows(seen + i * M, 1, factor, 1, axes, M, M, i + 1);
    }
    for (int i = 0; i < K; i++)
        for (int l = 0; l < 4; l++) {
            const sf_real *row = seen + (P + i) * M;
            for (int j = 0; j <= i; j++) L[4 * (i * K + j) + l] = row[P + j];
            L[4 * (i * K + i) + l] += 1 / (severities[l] * severities[l] * ratio[P + i]);
            for (int j = 0; j < P; j++) W[4 * (i * P + j) + l] = row[j];
            z[4 * i + l] = pull[P + i];
        }
    for (int l = 0; l < 4; l++) wide[l] = sf_log(severities[l]), odds[l] = sf_log(likely[l]);
    sf_cholesky_four(L, K, of_offsets);
    sf_solve_four(L, K, W, P, 0);
    sf_solve_four(L, K, z, 1, 0);
    /* Of what was halved: S = A - W' W, and what pulls at the scales. */
    for (int i = 0; i < P; i++) {
        for (int j = 0; j <= i; j++) {
            sf_real *out = S + 4 * (i * P + j);
            for (int l = 0; l < 4; l++) out[l] = seen[i * M + j];
            for (int k = 0; k < K; k++) sf_less_four(out, W + 4 * (k * P + i), W + 4 * (k * P + j));
        }
        for (int l = 0; l < 4; l++) x[4 * i + l] = pull[i];
        for (int k = 0; k < K; k++) sf_less_four(x + 4 * i, z + 4 * k, W + 4 * (k * P + i));
    }
    sf_solve_four(L, K, W, P, 1);
    sf_solve_four(L, K, z, 1, 1);
    for (int i = 0; i < 4; i++) {
        sf_with_prior(own, S, ratio, severities[i], P, of_scales);
        sf_copy(answer, x, 4 * P);
        sf_solve_four(own, P, answer, 1, 0);
        sf_solve_four(own, P, answer, 1, 1);
        sf_copy(answer + 4 * P, z, 4 * K);
        for (int j = 0; j < K; j++)
            for (int k = 0; k < P; k++) sf_less_four(answer + 4 * (P + j), W + 4 * (j * P + k), answer + 4 * k);
        for (int l = 0; l < 4; l++) {
            sf_real *here = found + (4 * i + l) * M, *out = evidence + 4 * i + l;
            for (int j = 0; j < M; j++) here[j] = answer[4 * j + l];
            *out = sf_dot(here, pull, M) - of_offsets[l] - of_scales[l] - constant - 2 * (sf_real)K * wide[l] -
                   2 * (sf_real)P * wide[i] + 2 * (odds[i] + odds[l]);
            if (*out > best) best = *out; /* not of NaN */
        }
    }
    if (!sf_finite(best)) return 0;
    for (int which = 0; which < 16; which++) {
        evidence[which] = sf_exp((evidence[which] - best) / 2);
        if (!(evidence[which] > 0)) evidence[which] = 0;
        total += evidence[which];
    }

    memset(mean, 0, (size_t)M * sizeof(sf_real));
    for (int which = 0; which < 16; which++) {
        evidence[which] /= total;
        if (evidence[which] > SF_NEGLIGIBLE) sf_add(mean, evidence[which], found + which * M, M);
        else evidence[which] = 0;
    }
    /* Lower halves, as far as they go. */
    memset(covariance, 0, (size_t)(M * M) * sizeof(sf_real));
    memset(mixed, 0, (size_t)(4 * P * P) * sizeof(sf_real));
    for (int i = 0; i < 4; i++) {
        const sf_real *of = evidence + 4 * i;
        if (!(of[0] + of[1] + of[2] + of[3] > 0)) continue;
        sf_with_prior(own, S, ratio, severities[i], P, of_scales);
        sf_inverse_four(own, P);
        for (int j = 0; j < P; j++)
            for (int k = 4 * P * j; k < 4 * (P * j + j + 1); k++) mixed[k] += of[k % 4] > 0 ? of[k % 4] * own[k] : 0;
        for (int l = 0; l < 4; l++) weight[l] += of[l];
    }
    for (int which = 0; which < 16; which++)
        for (int j = 0; j < M; j++) found[which * M + j] -= mean[j];
    for (int j = 0; j < M; j++) {
        sf_real apart[16];
        for (int which = 0; which < 16; which++)
            apart[which] = evidence[which] > 0 ? evidence[which] * found[which * M + j] : 0;
        sf_add_rows(covariance + j * M, 1, apart, 1, found, M, 16, j + 1);
    }
    sf_inverse_four(L, K);
    for (int l = 0; l < 4; l++)
        for (int i = 0; i < P && weight[l] > 0; i++)
            for (int j = 0; j <= i; j++) covariance[i * M + j] += mixed[4 * (i * P + j) + l];
    for (int i = 0; i < K; i++) {
        sf_real *out = covariance + (P + i) * M;
        memset(answer, 0, sizeof answer);
        for (int j = 0; j < P; j++)
            for (int k = 0; k < P; k++)
                sf_less_four(answer + 4 * j, W + 4 * (i * P + k), mixed + 4 * (k < j ? j * P + k : k * P + j));
        for (int j = 0; j <= i; j++) {
            sf_real *both = answer + 4 * (P + j);
            for (int l = 0; l < 4; l++) both[l] = weight[l] * L[4 * (i * K + j) + l];
            for (int k = 0; k < P; k++) sf_less_four(both, answer + 4 * k, W + 4 * (j * P + k));
        }
        for (int j = 0; j <= P + i; j++)
            for (int l = 0; l < 4; l++) out[j] += weight[l] > 0 ? answer[4 * j + l] : 0;
    }
    for (int i = 0; i < M; i++) {
        mean[i] = c->start[i] + std[i] * mean[i];
        for (int j = 0; j <= i; j++) covariance[i * M + j] *= std[i] * std[j];
    }
    for (int i = 0; i < M; i++)
        for (int j = i + 1; j < M; j++) covariance[i * M + j] = covariance[j * M + i];
    return sf_all_finite(mean, M) && sf_all_finite(covariance, M * M);
}

/* Uncertainty.to_force times a vector of M scales and offsets: what these do to (tared) forces. */
SF_API void sf_to_force(const sf_config *c, const sf_real *mean, const sf_real *tared, const sf_real *x, sf_real *out) {
    sf_real moved[SF_CHANNELS], by_scale[SF_CHANNELS];
    for (int i = 0; i < c->channels; i++) moved[i] = x[sf_scales(c) + i] * c->unit[i];
    sf_scaled(c, mean, moved, out);
    sf_scaled(c, x, tared, by_scale);
    for (int i = 0; i < c->channels; i++) out[i] += by_scale[i];
}

/* Uncertainty.of_parameters and of_channels: the covariance of (a, b) of each channel, b = A o in N. */
SF_API void sf_of_parameters(const sf_config *c, sf_state *s) {
    int K = c->channels, M = sf_map(c), wide = 2 * K;
    sf_real by[SF_CHANNELS * SF_MAP], tared[SF_CHANNELS], moved[SF_CHANNELS];
    for (int i = 0; i < K; i++) tared[i] = sf_tared(c, s->given, 0, i);
    for (int m = 0; m < M; m++) {
        sf_to_force(c, s->given, tared, s->given_covariance + m * M, moved);
        for (int i = 0; i < K; i++) by[i * M + m] = moved[i];
    }
    for (int i = 0; i < K; i++) {
        sf_to_force(c, s->given, tared, by + i * M, s->learnt + (K + i) * wide + K);
        for (int j = 0; j < K; j++) {
            s->learnt[i * wide + j] = s->given_covariance[i * M + j];
            s->learnt[(K + i) * wide + j] = s->learnt[j * wide + K + i] = by[i * M + j];
        }
    }
    for (int i = 0; i < K; i++) {
        s->spread[i] = s->learnt[i * wide + i];
        s->spread[K + i] = 2 * s->learnt[i * wide + K + i];
        s->spread[2 * K + i] = s->learnt[(K + i) * wide + K + i];
    }
}

/* ------------------------------------------------------------------------------------- moment: hypotheses */

/* Hypotheses: `out` and `flipped` are each channel's own, then two are exchanged, `straight` or `crossed`. */
SF_API int sf_about(const sf_config *c, int hypothesis, int channel) {
    int K = c->channels, pair = hypothesis - 2 * K;
    if (pair < 0) return hypothesis % K == channel;
    pair %= c->pairs;
    return c->first[pair] == channel || c->second[pair] == channel;
}

SF_API int sf_related(const sf_config *c, int one, int other) {
    for (int i = 0; i < c->channels; i++)
        if (sf_about(c, one, i) && sf_about(c, other, i)) return 1;
    return 0;
}

/* Residuals.mean_with for one hypothesis. */
SF_API sf_real sf_mean_with(const sf_config *c, const sf_newton *newton, const sf_real *change,
                            sf_real largest) {
    sf_real sum = 0, count = 0;
    for (int r = 0; r < sf_groups(c) * c->kinds; r++) {
        if (!newton->there[r]) continue;
        sf_real e = newton->residual[r] + (change ? change[r] : 0);
        sum += sf_clip(e * e / newton->spread[r], 0, largest);
        count++;
    }
    return sum / (count > (sf_real)0.5 ? count : 1);
}

/* Hypotheses.changes for one of them: the error of a force in N in row r, and what it does to the residual. */
SF_API sf_real sf_change(const sf_config *c, const sf_newton *newton, const sf_real *reading,
                         const sf_real *force, const sf_real *others, const sf_real *mean, int h, int r,
                         sf_real *error) {
    int K = c->channels, i = h % K, group = r / c->kinds;
    const sf_real *places = newton->places + r * K, *F0 = reading + group * K, *F = force + group * K;
    if (h < K) {
        *error = F[i] - sf_dot(F, others + i * K, K);
        return places[i] * *error;
    }
    if (h < 2 * K) {
        *error = 2 * F0[i];
        return places[i] * mean[i] * *error;
    }
    int pair = (h - 2 * K) % c->pairs, one = c->first[pair], two = c->second[pair];
    sf_real sign = h - 2 * K < c->pairs ? -1 : 1;
    *error = F0[one] + sign * F0[two];
    return (places[one] * mean[one] + sign * (places[two] * mean[two])) * *error;
}

/* Hypotheses._with_load: fit a load to all blocks since something seemed wrong; returns whether there can be one. */
SF_API int sf_with_load(const sf_config *c, sf_state *s, const sf_newton *newton, const sf_real *mean,
                        sf_real *change) {
    int N = sf_unknowns(c), M = sf_map(c), possible = 1, rows = sf_groups(c) * c->kinds;
    sf_real normal[9], fit[3];
    for (int r = 0; r < rows; r++) {
        const sf_real *column = newton->H + r * N + M;
        for (int i = 0; newton->there[r] && i < 3; i++) {
            sf_real weighted = column[i] / newton->spread[r];
            for (int j = 0; j < 3; j++) s->load[4 * i + j] += weighted * column[j];
            s->load[4 * i + 3] += weighted * newton->residual[r];
        }
    }
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) normal[3 * i + j] = s->load[4 * i + j] + (i == j) * c->load_loose[i];
        fit[i] = s->load[4 * i + 3];
    }
    memset(change, 0, (size_t)rows * sizeof(sf_real));
    if (!sf_cholesky(normal, 3)) return 0;
    sf_solve(normal, 3, fit, 1);
    for (int i = 0; i < 3; i++) possible = possible && sf_fabs(fit[i]) <= c->load_largest[i];
    for (int r = 0; r < rows; r++) change[r] = -sf_dot(newton->H + r * N + M, fit, 3);
    return possible && mean[M + 2] + fit[2] < SF_LIGHTER;
}

/* Hypotheses.repair: put flipped and exchanged channels right. */
SF_API void sf_repair(const sf_config *c, sf_state *s, int accepted) {
    int K = c->channels, pair = accepted - 2 * K;
    if (accepted < K) return;
    if (pair < 0) {
        int i = accepted - K;
        for (int j = 0; j < K; j++) s->faults.wiring[i * K + j] = -s->faults.wiring[i * K + j];
        s->faults.kind[i] ^= SF_FLIPPED;
        return;
    }
    sf_real sign = pair < c->pairs ? 1 : -1;
    sf_real *one = s->faults.wiring + c->first[pair % c->pairs] * K, *two = s->faults.wiring + c->second[pair % c->pairs] * K;
    for (int j = 0; j < K; j++) {
        sf_real before = one[j];
        one[j] = sign * two[j];
        two[j] = sign * before;
    }
    s->faults.kind[c->first[pair % c->pairs]] ^= SF_SWAPPED;
    s->faults.kind[c->second[pair % c->pairs]] ^= SF_SWAPPED;
}

/* ChannelFaults.contradicted, Hypotheses.evidence and decide: hold hypotheses against the robot's motion. `mean` is
   that before the block, `reading` and `force` are those of its groups. Sets whether a fault was found, or a load. */
SF_API void sf_contradicted(const sf_config *c, sf_state *s, const sf_newton *newton, const sf_real *mean,
                            const sf_real *reading, const sf_real *force, int *fault, int *loaded) {
    int K = c->channels, count = sf_hypotheses(c), rows = sf_groups(c) * c->kinds, possible = 0;
    sf_real others[SF_CHANNELS * SF_CHANNELS], spread[SF_CHANNELS], latest[SF_HYPOTHESES], change[SF_NEWTON];
    sf_real trust = s->trust += (sf_real)(newton->mean_square < SF_WELL);
    *fault = *loaded = 0;
    /* Most of the time nothing is wrong, and no hypothesis needs to be tried. */
    if (!(newton->mean_square > SF_SUSPICION || s->doubt > (sf_real)0.5)) return;
    sf_others(c, &s->faults, others, spread);

    /* The block in which a fault begins is half right: what counts are those behind it. */
    sf_real doubt = s->doubt + (sf_real)(s->doubt > (sf_real)0.5), whole = doubt > (sf_real)1.5 ? doubt - 1 : 1;
    int goes_on = doubt > (sf_real)1.5;
    if (!(doubt > (sf_real)2.5)) memset(s->load, 0, sizeof s->load);
    for (int h = 0; h < count + 2; h++) {
        sf_real mean_square = newton->mean_square;
        if (h == count + 1) {
            possible = sf_with_load(c, s, newton, mean, change);
            mean_square = sf_mean_with(c, newton, change, SF_CLIP);
        } else if (h > 0) {
            latest[h - 1] = 0;
            for (int r = 0; r < rows; r++) {
                sf_real error;
                change[r] = sf_change(c, newton, reading, force, others, mean, h - 1, r, &error);
                if (newton->there[r]) latest[h - 1] = sf_max(latest[h - 1], sf_fabs(error));
            }
            s->size[h - 1] = sf_max(goes_on ? s->size[h - 1] : 0, latest[h - 1]);
            mean_square = sf_mean_with(c, newton, change, SF_CLIP);
        }
        s->scores[h] = goes_on ? s->scores[h] + (mean_square - s->scores[h]) / whole : 0;
    }
    sf_real nothing = s->scores[0], by_load = possible ? s->scores[count + 1] : HUGE_VAL;
    if (doubt < (sf_real)0.5 && newton->mean_square > SF_SUSPICION) doubt = 1;
    if (doubt > SF_PATIENCE || (doubt > (sf_real)1.5 && nothing < SF_CALM)) doubt = 0;

    sf_real left[SF_HYPOTHESES], any_channel = HUGE_VAL, least = HUGE_VAL, rival = HUGE_VAL;
    int chosen = 0;
    for (int h = 0; h < count; h++) {
        int touched = 0, usable = h >= 2 * K || c->cells[h % K];
        for (int i = 0; i < K; i++) touched = touched || (s->faults.lost[i] > (sf_real)0.5 && sf_about(c, h, i));
        left[h] = usable && !touched ? s->scores[1 + h] * (h < K ? SF_LOSS : 1) : HUGE_VAL;
        /* Between its turns a broken cell carries little, and still explains what was wrong in them. */
        if (s->size[h] > SF_LEAST_ERROR * c->weight) any_channel = sf_min(any_channel, left[h]);
        /* What small errors of the reference could be as well is not put down to a channel. */
        if (!(latest[h] > SF_LEAST_ERROR * c->weight)) left[h] = HUGE_VAL;
        if (left[h] < least) {
            least = left[h];
            chosen = h;
        }
    }
    for (int h = 0; h < count; h++)
        if (!sf_related(c, chosen, h)) rival = sf_min(rival, left[h]);
    int ready = doubt > (sf_real)1.5 && trust >= SF_TRUST && nothing > SF_SUSPICION;
    *fault = ready && least < SF_RELIEF * nothing && least < SF_CONTRAST * rival &&
             least + SF_NOISE < SF_CONTRAST * (by_load + SF_NOISE);
    *loaded = ready && !*fault && doubt >= SF_LOAD_BLOCKS && by_load < SF_RELIEF * nothing &&
              by_load + SF_NOISE < SF_LOAD_CONTRAST * (any_channel + SF_NOISE);

    s->doubt = *fault || *loaded ? 0 : doubt;
    if (*loaded) s->trust = SF_TRUST;
    if (!*fault) return;
    if (chosen < K) {
        int out[SF_CHANNELS] = {0}, kind[SF_CHANNELS] = {0};
        out[chosen] = 1;
        kind[chosen] = SF_DEAD;
        sf_lose(c, &s->faults, out, kind);
    }
    sf_repair(c, s, chosen);
    s->faults.altered = 1;
}

/* ----------------------------------------------------------------------------------------- moment: stream */

/* Residuals.of the rows of Newton and Euler. */
SF_API void sf_residuals(const sf_config *c, const sf_real *mean, const sf_real *covariance, sf_newton *newton) {
    int N = sf_unknowns(c);
    for (int r = 0; r < sf_groups(c) * c->kinds; r++) {
        const sf_real *H = newton->H + r * N;
        newton->there[r] = 0;
        for (int k = 0; k < N; k++) newton->there[r] |= H[k] != 0;
        newton->residual[r] = newton->y[r] - sf_dot(H, mean, N);
        newton->spread[r] = sf_variance(H, covariance, N) + newton->variance[r];
    }
    newton->mean_square = sf_mean_with(c, newton, 0, SF_CLIP);
}

/* MomentStream._plausible: leave out groups of rows that no error of calibration explains, such as of a lifted robot;
   returns whether there are any. Noise that is learnt, or expected at first, is no reason to learn from them. */
SF_API int sf_plausible(const sf_config *c, const sf_real *covariance, sf_newton *newton) {
    int N = sf_unknowns(c), M = sf_map(c), rejected = 0;
    for (int group = 0; group < sf_groups(c); group++) {
        int wrong = 0;
        for (int r = group * c->kinds; r < (group + 1) * c->kinds; r++) {
            sf_real e = newton->residual[r], H[SF_UNKNOWNS];
            if (!(sf_fabs(e) > c->reject)) continue;
            for (int k = 0; k < N; k++) H[k] = newton->H[r * N + k] / (k < M ? SF_FIRST_WIDTH : 1);
            wrong = wrong || e * e > SF_REJECT_STD * SF_REJECT_STD *
                                         (sf_variance(H, covariance, N) + newton->assumed[r]);
        }
        for (int r = group * c->kinds; r < (group + 1) * c->kinds; r++)
            newton->kept[r] = newton->there[r] && !wrong;
        rejected = rejected || wrong;
    }
    return rejected;
}

/* MomentStream._changed: whether the force of a whole block leaps away from what the motion asks for. */
SF_API int sf_changed(const sf_config *c, const sf_real *mean, const sf_real *covariance,
                      const sf_newton *newton) {
    int N = sf_unknowns(c);
    sf_real row[SF_UNKNOWNS] = {0}, count = 0, e = 0, variance = 0;
    for (int r = c->kinds == 6 ? SF_FZ : 0; r < sf_groups(c) * c->kinds; r += c->kinds) {
        if (!newton->kept[r]) continue;
        count++;
        sf_add(row, 1, newton->H + r * N, N);
        e += newton->y[r];
        variance += newton->variance[r];
    }
    if (!(count > (sf_real)0.5)) return 0;
    for (int k = 0; k < N; k++) row[k] /= count;
    e = e / count - sf_dot(row, mean, N);
    sf_real spread = sf_variance(row, covariance, N) + variance / (count * count);
    return e * e > SF_LEAP_STD * SF_LEAP_STD * spread && sf_fabs(e) > SF_LEAST_CHANGE_OF_MASS * c->mass_change;
}

/* MomentStream._quiet: blocks in which a robot has not moved are one measurement, however long it stands;
   returns by how much the variances of the rows grow. */
SF_API sf_real sf_quiet(const sf_config *c, sf_state *s, const sf_block *b) {
    int moved = 0, n = sf_span(c);
    sf_real middle[SF_CHANNELS];
    for (int i = 0; i < c->channels; i++) {
        sf_real high = sf_block_force(b, 0)[i], low = high, limit = c->still * c->unit[i];
        for (int t = 1; t < n; t++) {
            high = sf_max(high, sf_block_force(b, t)[i]);
            low = sf_min(low, sf_block_force(b, t)[i]);
        }
        middle[i] = (sf_real)0.5 * (high + low);
        moved = moved || high - low >= 2 * limit || sf_fabs(middle[i] - s->anchor[i]) > limit;
    }
    s->quiet = moved ? 0 : s->quiet + 1;
    if (moved) sf_copy(s->anchor, middle, c->channels);
    return (1 + s->quiet) * (1 + s->quiet);
}

/* MomentStream._walked: the time of some blocks, in which the unknowns have drifted. */
SF_API void sf_walked(const sf_config *c, sf_state *s, sf_real blocks) {
    int M = sf_map(c), N = sf_unknowns(c);
    sf_real walk[SF_UNKNOWNS];
    sf_walk(c, s, walk);
    for (int i = 0; i < N; i++) s->covariance[i * N + i] += blocks * walk[i];
    for (int i = 0; i < M; i++) {
        s->drift[i] += blocks * walk[i];
        s->given_covariance[i * M + i] += blocks * walk[i];
    }
    for (int foot = 0; foot < c->feet; foot++)
        if (!(s->swing_ago[foot] < 0)) s->swing_ago[foot] += blocks;
}

/* The lower half of a symmetric S of N rows, row by row. */
SF_API void sf_keep(sf_real *half, const sf_real *S, int N) {
    for (int i = 0; i < N; i++) sf_copy(half + sf_half(i), S + i * N, i + 1);
}

/* MomentStream._back: what the robot knew some seconds ago. */
SF_API void sf_back(const sf_config *c, sf_state *s) {
    int N = sf_unknowns(c);
    sf_copy(s->mean, s->kept_mean, N);
    for (int i = 0; i < N; i++)
        for (int k = 0; k <= i; k++)
            s->covariance[i * N + k] = s->covariance[k * N + i] = s->kept_covariance[sf_half(i) + k];
    memset(s->pending, 0, (size_t)(sf_span(c) * sf_width(c)) * sizeof(sf_real));
}

/* MomentStream._given: what is handed out of what is due, SF_SPREAD or SF_ALL. It moves only where the unknowns did,
   as without new rows only the uncertainty changes, and not while they are unproven: a fall shows some moments
   after it has begun. */
SF_API void sf_given(const sf_config *c, sf_state *s, sf_work *w) {
    int M = sf_map(c), N = sf_unknowns(c);
    if (s->unproven < (sf_real)0.5) {
        sf_real mean[SF_MAP], walk[SF_UNKNOWNS];
        if (sf_reweighted(c, s, &w->part.severity, mean)) {
            if (s->due >= SF_ALL) {
                sf_copy(s->given, mean, M);
                sf_copy(s->given + M, s->mean + M, N - M);
            }
            sf_copy(s->given_covariance, w->part.severity.covariance, M * M);
            /* They have drifted since they were learnt. */
            sf_walk(c, s, walk);
            for (int i = 0; i < M; i++)
                s->given_covariance[i * M + i] += walk[i] * (sf_real)(c->settle + c->every) / (sf_real)c->every;
        }
    }
    sf_of_parameters(c, s);
    s->due = 0;
}

/* MomentStream._doubted: hand out what is known now for a while. */
SF_API void sf_doubted(const sf_config *c, sf_state *s, sf_work *w) {
    s->unproven = 0;
    s->due = SF_ALL;
    sf_given(c, s, w);
    s->unproven = (sf_real)c->keep_every;
}

/* MomentStream._watch: look for faults in what the block left unexplained; and go back to before one that is
   found. `before` is the mean before the block, `mean` that with which the rows were written, `lost` what was lost
   before it, `use_all` whether all samples were used. */
SF_API void sf_watch(const sf_config *c, sf_state *s, sf_work *w, const sf_block *b, const sf_real *before,
                     const sf_real *mean, const sf_real *lost, int use_all) {
    int K = c->channels, N = sf_unknowns(c), groups = sf_groups(c), fault, loaded, found, moved = 0;
    sf_real reading[SF_GROUPS * SF_CHANNELS], force[SF_GROUPS * SF_CHANNELS];
    sf_readings(c, b, reading);
    for (int g = 0; g < groups; g++) sf_forces(c, mean, reading + g * K, force + g * K);
    found = memcmp(lost, s->faults.lost, (size_t)K * sizeof(sf_real)) != 0;
    sf_contradicted(c, s, &w->newton, mean, reading, force, &fault, &loaded);
    found = found || fault;
    for (int g = 0; g < groups; g++) sf_forces(c, s->given, reading + g * K, force + g * K);
    sf_fault_learn(c, &s->faults, force, sf_groups(c), use_all && !found && s->doubt < (sf_real)0.5);
    for (int i = 0; loaded && i < N; i++) s->covariance[i * N + i] += c->change[i];
    if (found) sf_back(c, s);
    for (int i = 0; i < N; i++) moved = moved || sf_fabs(s->mean[i] - before[i]) > SF_ROUNDING;
    s->due = moved ? SF_ALL : SF_SPREAD;
    if (found) sf_given(c, s, w); /* what a fault has spoilt is put right at once */
    if (s->step / c->every % c->keep_every == 0) {
        sf_copy(s->kept_mean, s->kept_mean + N, N);
        sf_copy(s->kept_mean + N, s->mean, N);
        sf_copy(s->kept_covariance, s->kept_covariance + sf_half(N), sf_half(N));
        sf_keep(s->kept_covariance + sf_half(N), s->covariance, N);
    }
}

/* ErrorProduct._wider: what a row is less sure by, of what a newton on each channel does to it and the variances of
   products of the errors of scales and offsets. */
SF_API sf_real sf_of_product(const sf_config *c, const sf_real *places, const sf_real *product) {
    sf_real more = 0;
    for (int k = 0; k < c->channels; k++) {
        sf_real lever = places[k] * c->unit[k];
        more += lever * lever * product[k];
    }
    return more;
}

/* MomentStream._step: learn from rows, and say whether all of what came is finite. */
SF_API int sf_step(const sf_config *c, sf_state *s, sf_work *w, sf_real *nis, sf_real *nis_rows) {
    int N = sf_unknowns(c), com = sf_map(c), walks = 0;
    sf_real learnt[SF_UNKNOWNS];
    for (int foot = 0; foot < c->feet; foot++) {
        sf_real since = s->swing_ago[foot] * (c->every * c->dt);
        walks = walks || (since >= 0 && since <= SF_STRIDE);
    }
    /* The mass only while it is much less sure than it began, the centre of mass until strides repeat. */
    for (int i = 0; i < N; i++) {
        sf_real sure = c->sure[i] * (walks || i < com || i > com + 1 ? 1 : SF_STILL * SF_STILL);
        learnt[i] = w->covariance[i * N + i] > sure ? c->learnt[i] : 0;
    }
    return sf_kalman_step(s->mean, w->covariance, &w->rows, learnt, N, c->gate, &w->part.kalman, nis, nis_rows);
}

/* MomentStream._learn: update the unknowns by the block that is full. The covariance of the work is that after
   the block, until all is known to be finite. */
SF_API void sf_learn(const sf_config *c, sf_state *s, sf_work *w, sf_real *nis, sf_real *nis_rows) {
    int K = c->channels, P = sf_scales(c), M = sf_map(c), N = sf_unknowns(c), n = sf_span(c);
    int m = sf_groups(c) * c->kinds, use_all = 1, all_there = 1, swinging = 0, unused = 1, rejected = 0;
    sf_block b = {s->pending, sf_width(c), {0}};
    sf_newton *newton = &w->newton;
    sf_rows *rows = &w->rows;
    sf_real before[SF_UNKNOWNS], mean[SF_UNKNOWNS], *covariance = w->covariance, tare_nis = 0, tare_rows = 0;
    sf_real lost[SF_CHANNELS], product[SF_CHANNELS], count[SF_FEET] = {0}, reading[SF_CHANNELS] = {0};
    sf_copy(lost, s->faults.lost, K);
    sf_silent(c, &s->faults, s->pending, sf_block_read(c, &b, 0), b.width, n, 1);
    /* MomentStream._complete: which samples have all readings that they need. */
    for (int t = 0; t < n; t++) {
        sf_real asked[3];
        int complete = sf_block_sound(c, &b, t) != 0 && sf_ground(c, sf_block_motion(c, &b, t), 0, asked);
        for (int i = 0; i < K; i++) {
            int replaced = s->faults.lost[i] > (sf_real)0.5 && s->faults.spare_std[i] < SF_UNSURE * c->weight;
            complete = complete &&
                       (replaced || (s->faults.lost[i] < (sf_real)0.5 && sf_block_read(c, &b, t)[i] > (sf_real)0.5));
        }
        b.use[t] = (sf_real)complete;
        use_all = use_all && complete;
        for (int foot = 0; foot < c->feet; foot++)
            swinging = swinging || sf_block_swing(c, &b, t)[foot] > (sf_real)0.5;
    }
    for (int i = 0; i < K; i++) all_there = all_there && s->faults.lost[i] < (sf_real)0.5;

    sf_walked(c, s, 1);
    /* MomentStream._tared: first of all, so that the columns of all other rows hold the offsets known by now. */
    rows->count = 0;
    if (swinging) rejected = sf_tare(c, s, &b, rows, count, reading);
    sf_copy(before, s->mean, N);
    sf_copy(covariance, s->covariance, N * N);
    int tared = sf_step(c, s, w, &tare_nis, &tare_rows);
    if (!tared) {
        sf_copy(s->mean, before, N);
        sf_copy(covariance, s->covariance, N * N);
        tare_nis = tare_rows = 0;
    }
    sf_copy(mean, s->mean, N);
    sf_newton_euler_rows(c, s, &b, newton);
    /* ErrorProduct.unsure. */
    for (int k = 0; k < K; k++) product[k] = covariance[k * N + k] * covariance[(P + k) * N + P + k];
    for (int r = 0; r < m; r++) {
        sf_real factor = s->noise[r % c->kinds];
        newton->assumed[r] = newton->variance[r] / factor;
        newton->variance[r] += SF_SHARED * factor * sf_of_product(c, newton->places + r * K, product);
    }
    sf_residuals(c, mean, covariance, newton);
    rejected = sf_plausible(c, covariance, newton) || rejected;

    /* ChannelFaults.suspects and unexplained: wait with learning as something seems wrong since short; what
       still does when no channel was found to be is the robot itself. */
    int waiting = (newton->mean_square > SF_SUSPICION || s->doubt > (sf_real)0.5) && s->doubt < SF_WAIT &&
                  s->trust >= SF_TRUST;
    int changed = sf_changed(c, mean, covariance, newton) || (s->doubt >= SF_WAIT && s->scores[0] > SF_SUSPICION);
    changed = changed && s->trust >= SF_SETTLED && !waiting;
    if (changed) s->trust = SF_TRUST;
    if (waiting) {
        sf_copy(s->mean, before, N);
        sf_copy(covariance, s->covariance, N * N);
        tare_nis = tare_rows = 0;
    }
    for (int i = 0; changed && i < N; i++) covariance[i * N + i] += c->change[i];

    sf_real quieter = sf_quiet(c, s, &b);
    sf_drift_followed(c, s, count, reading);
    /* ErrorProduct.drifted and since_swing. */
    for (int k = 0; k < K; k++) {
        int foot = c->foot_of_channel[k], hangs = count[foot] > (sf_real)0.5;
        sf_real blocks = hangs ? 0 : sf_clip(s->swing_ago[foot] + 1, 0, SF_LONGEST_STANCE / (c->every * c->dt));
        product[k] = covariance[k * N + k] * (s->rate * blocks * blocks * c->walk[P + k]);
    }
    rows->count = 0;
    for (int r = 0; r < m; r++) {
        unused = unused && !newton->kept[r];
        if (!newton->kept[r]) continue;
        sf_copy(rows->H + rows->count * N, newton->H + r * N, N);
        rows->y[rows->count] = newton->y[r];
        rows->variance[rows->count++] =
            newton->variance[r] * quieter + (sf_real)m * sf_of_product(c, newton->places + r * K, product);
    }
    unused = unused || waiting;
    if (c->parities > 0 && all_there) sf_parity_rows(c, s, &b, rows);
    if (waiting) rows->count = 0;

    int finite = sf_step(c, s, w, nis, nis_rows);
    *nis += tare_nis;
    *nis_rows += tare_rows;
    if (finite) {
        /* _limits: what a sensor can be, by where it began and how far it can drift */
        for (int i = 0; i < M; i++) {
            sf_real reach = SF_REACH * sf_sqrt(SF_FIRST_WIDTH * SF_FIRST_WIDTH * c->stated[i] + s->drift[i]);
            sf_real within = sf_clip(s->mean[i], c->start[i] - reach, c->start[i] + reach);
            rejected = rejected || within != s->mean[i];
            s->mean[i] = within;
        }
        sf_copy(s->covariance, covariance, N * N);
    } else {
        rejected = 1;
        sf_copy(s->mean, before, N);
    }
    if (!unused) {
        s->unproven = sf_max(s->unproven - 1, 0);
        s->misfit += SF_MISFIT_MEMORY * (sf_mean_with(c, newton, 0, SF_LARGEST_MISFIT) - s->misfit);
    }
    s->status = (rejected ? SF_REJECTED : 0) | (finite && tared ? 0 : SF_SINGULAR);
    sf_watch(c, s, w, &b, before, mean, lost, use_all);

    /* followed_noise; what no fault and no load explains is noise, and a robot that stands shows little of it. */
    sf_real least = s->scores[1];
    for (int h = 2; h < sf_hypotheses(c) + 2; h++) least = sf_min(least, s->scores[h]);
    int explicable = s->doubt > (sf_real)0.5 && least < SF_CONTRAST * s->scores[0];
    for (int kind = 0; !unused && !(s->quiet > (sf_real)0.5) && !explicable && kind < c->kinds; kind++) {
        sf_real surplus = 0;
        for (int r = kind; r < m; r += c->kinds)
            if (newton->there[r])
                surplus += sf_clip(newton->residual[r] * newton->residual[r] / newton->spread[r], 0,
                                   SF_LARGEST_SQUARE) -
                           1;
        surplus /= (sf_real)sf_groups(c);
        s->noise[kind] = sf_clip(s->noise[kind] * (1 + SF_NOISE_MEMORY * surplus), 1, SF_LOUDEST);
    }
    /* The next block begins with the last samples of this one. */
    memmove(s->pending, s->pending + c->every * b.width, (size_t)((n - c->every) * b.width) * sizeof(sf_real));
}

/* What forces that are added up so say of (a, b), or of the unknowns where there is cross-talk. */
SF_API void sf_row_of(const sf_config *c, const sf_real *mean, const sf_real *F0, const sf_real *tared,
                      const sf_real *sum, sf_real *row) {
    int K = c->channels;
    if (c->talks) {
        memset(row, 0, (size_t)sf_scales(c) * sizeof(sf_real));
        sf_by_scale(c, 1, sum, tared, row);
        sf_by_offset(c, sum, mean, row + sf_scales(c));
        return;
    }
    for (int i = 0; i < K; i++) {
        row[i] = sum[i] * F0[i];
        row[K + i] = sum[i];
    }
}

/* The covariances of two such rows: of one, of both, of the other. */
SF_API void sf_known(const sf_config *c, const sf_real *known, const sf_real *one, const sf_real *other,
                     sf_real out[3]) {
    int M = c->talks ? sf_map(c) : 2 * c->channels;
    out[0] = out[1] = out[2] = 0;
    for (int i = 0; i < M; i++) {
        if (one[i] == 0 && other[i] == 0) continue; /* most of a single channel's */
        sf_real own = sf_dot(known + i * M, one, M), its = sf_dot(known + i * M, other, M);
        out[0] += one[i] * own, out[1] += one[i] * its, out[2] += other[i] * its;
    }
}

/* MomentStream._estimate with FrontEnd.report and Uncertainty.of_estimate: apply the map to the newest sample. */
SF_API void sf_estimate_of(const sf_config *c, const sf_state *s, const sf_sample *sample, sf_estimate *out) {
    int K = c->channels, P = sf_scales(c), M = c->talks ? sf_map(c) : 2 * K;
    const sf_real *F0 = sample->force;
    /* The row of a channel is (F0, 1), of (a, b); that of one with cross-talk is longer, of the unknowns. */
    const sf_real *known = c->talks ? s->given_covariance : s->learnt;
    sf_real moved[SF_CHANNELS], change[SF_CHANNELS];
    sf_real rows[3 * SF_CHANNELS], own[3 * SF_CHANNELS], force[SF_CHANNELS], tared[SF_CHANNELS], b[SF_CHANNELS];
    sf_real turned[2 * SF_MAP], found[3], one[SF_CHANNELS];
    sf_level_rows(c, s->front.motion, rows);
    for (int i = 0; i < K; i++) {
        tared[i] = sf_tared(c, s->given, F0[i], i);
        b[i] = s->given[P + i] * c->unit[i];
    }
    sf_scaled(c, s->given, b, out->offset);
    sf_scaled(c, s->given, tared, force);
    sf_scaled(c, s->given, sample->change, moved);
    for (int i = 0; i < K; i++) {
        out->scale[i] = s->given[i] * c->scale[i];
        out->offset[i] = s->given[i] * c->offset[i] + out->offset[i];
        out->flags[i] = sample->flags[i] | s->status;
    }
    for (int i = 0; i < K; i++) {
        out->force[i] = s->faults.altered ? sf_dot(s->faults.spare + i * K, force, K) : force[i];
        change[i] = s->faults.altered ? sf_dot(s->faults.spare + i * K, moved, K) : moved[i];
    }

    sf_real load = sf_report_now(c, &s->front, rows, change, out);

    /* The variance of a force is that of its row; that of the centre of pressure p = n / Fz, to first order, of
       (p_i - p) / Fz times the same row. */
    for (int i = 0; i < K; i++) {
        sf_real variance = (F0[i] * s->spread[i] + s->spread[K + i]) * F0[i] + s->spread[2 * K + i];
        if (s->faults.altered || c->talks) {
            for (int j = 0; j < K; j++) one[j] = s->faults.altered ? s->faults.spare[i * K + j] : (sf_real)(i == j);
            sf_row_of(c, s->given, F0, tared, one, turned);
            sf_known(c, known, turned, turned, found);
            variance = found[0] + s->faults.spare_std[i] * s->faults.spare_std[i];
        }
        out->force_std[i] = sf_sqrt(variance > 0 ? variance : 0);
    }
    const sf_real *seen = rows;
    if (s->faults.altered) {
        sf_multiply(own, rows, s->faults.spare, 3, K, K);
        seen = own;
    }
    if (!out->cop_valid) load = 1;
    for (int axis = 0; axis < 2; axis++) {
        for (int i = 0; i < K; i++) one[i] = (seen[(1 + axis) * K + i] - out->cop[axis] * seen[i]) / load;
        sf_row_of(c, s->given, F0, tared, one, turned + axis * M);
    }
    sf_known(c, known, turned, turned + M, found);
    for (int i = 0; i < 4; i++) out->cop_covariance[i] = found[(i + 1) / 2];
}

/* ----------------------------------------------------------------------------------------- the calibrator */

/* MomentStream.init: the state before any sample. */
SF_API void sf_calibrator_init_with(const sf_config *c, sf_state *s, sf_work *w) {
    int N = sf_unknowns(c), M = sf_map(c);
    memset(s, 0, sizeof *s);
    sf_front_init(c, &s->front);
    sf_channel_faults_init(c, &s->faults, s->front.raw);
    for (int i = 0; i < N; i++) {
        s->covariance[i * N + i] = c->first_variance[i];
        if (i < M) s->given_covariance[i * M + i] = c->first_variance[i];
    }
    sf_copy(s->mean, c->start, N);
    sf_copy(s->given, c->start, N);
    for (int kept = 0; kept < 2; kept++) {
        sf_copy(s->kept_mean + kept * N, s->mean, N);
        sf_keep(s->kept_covariance + kept * sf_half(N), s->covariance, N);
    }
    for (int kind = 0; kind < c->kinds; kind++) s->noise[kind] = SF_FIRST_NOISE;
    s->misfit = SF_FIRST_MISFIT;
    s->rate = 1;
    for (int foot = 0; foot < c->feet; foot++) s->swing_ago[foot] = -1;
    sf_doubted(c, s, w);
}

/* MomentStream.retract: take back what was learnt in the last seconds, for a robot that has fallen or was seized. */
SF_API void sf_calibrator_retract_with(const sf_config *c, sf_state *s, sf_work *w) {
    int N = sf_unknowns(c);
    sf_back(c, s);
    sf_copy(s->kept_mean + N, s->kept_mean, N);
    sf_copy(s->kept_covariance + sf_half(N), s->kept_covariance, sf_half(N));
    sf_doubted(c, s, w);
}

/* MomentStream.update with FrontEnd.observe: take in one sample.

   raw: K readings, NaN where none arrived. reference: the robot's beliefs `lag` samples ago. dt: time since
   the last sample in s. Values never stop it: what is not finite or not possible is held and flagged.
   Returns whether something new is handed out. */
SF_API int sf_calibrator_step_with(const sf_config *c, sf_state *s, sf_work *w, const sf_real *raw,
                                   const sf_reference *reference, sf_real dt, sf_estimate *estimate) {
    int K = c->channels, R = sf_motion(c), width = sf_width(c), gap, standing = 0, fresh = 0;
    sf_real *newest;
    const sf_real *past = sf_past(c, &s->front);
    sf_whole kinds[SF_CHANNELS];
    sf_sample sample;

    sf_check(c, &s->front, raw, reference, 0, dt, &sample);
    sf_fault_sample(c, &s->faults, s->given, sample.force, sample.read, kinds);
    sf_align(c, &s->front, &sample);
    gap = sample.gap;

    /* The sample that the reference describes waits until its block is full. */
    if (gap) memset(s->pending, 0, (size_t)(sf_span(c) * width) * sizeof(sf_real));
    newest = s->pending + (2 * c->settle + s->step % c->every) * width;
    sf_copy(newest, past, K);
    sf_copy(newest + K, s->front.motion, R);
    newest += K + R;
    for (int i = 0; i < K; i++) newest[i] = (sf_real)(past[K + i] > (sf_real)0.5);
    for (int foot = 0; foot < c->feet; foot++) {
        newest[K + foot] = (sf_real)(reference->swing[foot] && sample.sound);
        standing = standing || (reference->stance[foot] && sample.sound);
    }
    newest[K + c->feet] = (sf_real)standing;
    newest[K + c->feet + 1] = (sf_real)(sample.sound && !gap);

    s->step++;
    if (gap && dt > 0 && sf_finite(dt)) sf_walked(c, s, sf_min(dt, SF_LONGEST_PAUSE) / (c->every * c->dt));
    estimate->nis = (sf_real)NAN;
    estimate->nis_rows = 0;
    if (s->step % c->every == 0) {
        sf_learn(c, s, w, &estimate->nis, &estimate->nis_rows);
        for (int i = 0; i < K; i++) kinds[i] |= s->faults.kind[i];
        fresh = s->due == 0;
    }
    if (s->step % c->every == (c->every > 1) && s->due > 0) {
        sf_given(c, s, w);
        fresh = 1;
    }
    for (int i = 0; i < K; i++) sample.flags[i] |= kinds[i];
    sf_estimate_of(c, s, &sample, estimate);
    return fresh;
}

/* The same three with the work on the stack. */
SF_API void sf_calibrator_init(const sf_config *c, sf_state *s) {
    sf_work work;
    sf_calibrator_init_with(c, s, &work);
}

SF_API void sf_calibrator_retract(const sf_config *c, sf_state *s) {
    sf_work work;
    sf_calibrator_retract_with(c, s, &work);
}

SF_API int sf_calibrator_step(const sf_config *c, sf_state *s, const sf_real *raw,
                              const sf_reference *reference, sf_real dt, sf_estimate *estimate) {
    sf_work work;
    return sf_calibrator_step_with(c, s, &work, raw, reference, dt, estimate);
}

#endif
