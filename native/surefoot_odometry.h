/* Which way is up and ahead, and how fast one robot moves, in C99: by a gyroscope that soles on a level floor hold
   upright, or by increments of an IMU that the legs that stand hold.

   The specification is the Python in robot/beliefs/odometry.py and strapdown.py, whose module docstrings derive it.

   Before it is included: SF_CORNERS is the largest number of parts of a foot that may touch; for what
   surefoot_nominal.h takes see there. */

#ifndef SUREFOOT_ODOMETRY_H
#define SUREFOOT_ODOMETRY_H

#include "surefoot_nominal.h"

#ifndef SF_CORNERS
#define SF_CORNERS 16
#endif

/* Places of a row's vectors behind those of sf_row_own; the last four follow from neighbours or are as measured. */
enum {
    SF_OWN_MOMENTUM = 0,
    SF_OWN_FORCE = 3,
    SF_OWN_ACCELERATION = 6,
    SF_OWN_RATE = 9,
    SF_OWN_ACCELEROMETER = 12,
    SF_OWN_GYROSCOPE = 15,
    SF_OWN = 18
};
#define SF_ROW (SF_ROW_SOLES + 12 * SF_FEET + SF_OWN) /* the widest one */

/* Constants of the Python modules, by their names there. */
#define SF_TILT_TIME ((sf_real)0.3)
#define SF_SPIN_BIAS_TIME ((sf_real)3.0)
#define SF_REST_TIME ((sf_real)10.0)
#define SF_FREE_FALL ((sf_real)0.5) /* of gravity */
#define SF_SOLE_HEIGHT ((sf_real)0.003)

/* ------------------------------------------------------------------------------------------------ records */

/* When packets leave and samples are taken, and what of the feet may touch; StrapdownConstants by their names. */
typedef struct {
    int averaged;       /* whether a sample of the IMU is the mean since the packet before */
    int joined;         /* how many packets become one, of which the period is */
    int needed, window; /* contacts.planned_window: for how long a plan must have held, and what is kept */
    int feet, points;   /* and how many parts of each may touch */
    int rolls;          /* whether feet are round, so that they stand on any of their sides */
    sf_real dt, gravity; /* time between samples of the feet in s; m/s^2 */
    sf_real leg_time, tilt_rate, zero_offset, bias_time, touch;
    sf_real corners[SF_FEET * SF_CORNERS * 3], radius[SF_FEET * SF_CORNERS]; /* centres in the sole frames; m */
    double period, delay; /* time between packets and their mean delay in s */
} sf_timing;

/* Strapdown */
typedef struct {
    sf_real R[9], velocity[3], place[3], spin_bias[3], vertical_bias;
    sf_whole count;
} sf_strapdown;

/* Odometry, or of round feet RollingOdometry, of which `rolling` is. */
typedef struct {
    sf_real forward[3], up[3], spin[3], spin_bias[3], force_bias[3];
    sf_whole count;
    sf_strapdown rolling;
} sf_odometry;

/* Posture: the robot at the middle between two packets, in the torso's axes, as sf_evaluate leaves it. */
typedef struct {
    sf_real local[SF_ROW], speeds[3 + 6 * (1 + SF_FEET)], force[3], spin[3];
} sf_posture;

/* Before any packet. */
SF_API void sf_strapdown_init(sf_strapdown *s) {
    memset(s, 0, sizeof *s);
    s->R[0] = s->R[4] = s->R[8] = 1;
}

SF_API void sf_odometry_init(sf_odometry *s) {
    memset(s, 0, sizeof *s);
    s->forward[0] = s->up[2] = 1;
    sf_strapdown_init(&s->rolling);
}

/* -------------------------------------------------------------------------------------------------- soles */

/* Odometry._upright: which way is up by the lowest sole, or by those that are level with each other. */
SF_API void sf_upright_by_soles(const sf_timing *t, const sf_odometry *s, const sf_real *row, sf_real *up) {
    int F = t->feet;
    sf_real weight[SF_FEET], total = 0;
    for (int i = 0; i < F; i++) weight[i] = 1;
    for (int i = 0; i < F; i++) {
        const sf_real *one = row + SF_ROW_SOLES + 3 * i;
        for (int j = i + 1; j < F; j++) {
            const sf_real *other = row + SF_ROW_SOLES + 3 * j;
            sf_real above = ((one[0] - other[0]) * s->up[0] + (one[1] - other[1]) * s->up[1] +
                             (one[2] - other[2]) * s->up[2]) /
                            SF_SOLE_HEIGHT;
            sf_real beats = (sf_real)0.5 * sf_clip(1 - above, 0, 2);
            weight[i] *= beats, weight[j] *= 1 - beats;
        }
        total += weight[i];
    }
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < F; i++) {
            sf_real part = weight[i] * row[sf_row_axes(F) + 9 * i + 6 + k];
            up[k] = i ? up[k] + part : part;
        }
        up[k] /= total;
    }
}

/* Odometry.turn: take in one middle between packets, and return the rotation R from the torso's axes. */
SF_API void sf_odometry_turn(const sf_timing *t, sf_odometry *s, const sf_posture *posture, sf_real *R) {
    const sf_real *spin = posture->spin, *force = posture->force;
    sf_real period = (sf_real)t->period, by[3], up[3], pull[3], moved[3], first, share, along;
    s->count++;
    first = 1 / (sf_real)s->count;
    for (int k = 0; k < 3; k++) {
        by[k] = ((sf_real)0.5 * (spin[k] + s->spin[k]) - s->spin_bias[k]) * period;
        s->spin[k] = spin[k];
    }
    sf_upright_by_soles(t, s, posture->local, up);
    sf_cross(moved, by, s->up);
    for (int k = 0; k < 3; k++) s->up[k] -= moved[k];
    sf_cross(pull, s->up, up);
    /* The first middles are averaged: nothing was known before. */
    share = sf_max(first, period / SF_TILT_TIME);
    for (int k = 0; k < 3; k++) {
        s->spin_bias[k] += period / (SF_TILT_TIME * SF_SPIN_BIAS_TIME) * pull[k];
        s->up[k] += share * (up[k] - s->up[k]);
    }
    sf_unit_vector(s->up);

    sf_cross(moved, by, s->forward);
    for (int k = 0; k < 3; k++) s->forward[k] -= moved[k];
    along = s->forward[0] * s->up[0] + s->forward[1] * s->up[1] + s->forward[2] * s->up[2];
    for (int k = 0; k < 3; k++) s->forward[k] -= along * s->up[k];
    sf_unit_vector(s->forward);
    sf_copy(R, s->forward, 3);
    sf_cross(R + 3, s->up, s->forward);
    sf_copy(R + 6, s->up, 3);

    if (sf_square(force) > sf_power2(SF_FREE_FALL * t->gravity)) {
        share = sf_max(first, period / SF_REST_TIME);
        for (int k = 0; k < 3; k++)
            s->force_bias[k] += share * (force[k] - t->gravity * s->up[k] - s->force_bias[k]);
    }
}

/* ------------------------------------------------------------------------------------------------- strapdown */

/* Strapdown.begin: begin with what the specific force of a robot at rest shows of up. */
SF_API void sf_strapdown_begin(sf_strapdown *s, const sf_real *force) {
    sf_real *forward = s->R, *left = s->R + 3, *up = s->R + 6, by = 1 / sf_sqrt(sf_square(force));
    sf_strapdown_init(s);
    for (int k = 0; k < 3; k++) up[k] = force[k] * by;
    for (int k = 0; k < 3; k++) forward[k] = (sf_real)(k == 0) - up[0] * up[k];
    by = 1 / sf_sqrt(sf_square(forward));
    for (int k = 0; k < 3; k++) forward[k] *= by;
    sf_cross(left, up, forward);
}

/* _rotation: by a small angle, to second order. */
SF_API void sf_small_rotation(const sf_real *turn, sf_real factor, sf_real *R) {
    sf_real a[3] = {factor * turn[0], factor * turn[1], factor * turn[2]};
    sf_real cross[9] = {0, -a[2], a[1], a[2], 0, -a[0], -a[1], a[0], 0}, square[9];
    sf_then(square, cross, cross);
    for (int i = 0; i < 9; i++) R[i] = (sf_real)(i % 4 == 0) + cross[i] + (sf_real)0.5 * square[i];
}

/* touching: mean velocity of the feet's points that touch the ground, relative to the torso, in its axes.
   up: against gravity. */
SF_API void sf_touching(const sf_timing *t, const sf_posture *posture, const sf_real *up, sf_real *mean) {
    sf_real height[SF_FEET * SF_CORNERS], arm[SF_FEET * SF_CORNERS * 3], low = 0, total = 0, sum[3] = {0, 0, 0};
    int count = t->feet * t->points;
    for (int i = 0; i < count; i++) {
        int foot = i / t->points;
        const sf_real *axes = posture->local + sf_row_axes(t->feet) + 9 * foot;
        const sf_real *site = posture->local + SF_ROW_SOLES + 3 * foot;
        sf_turn_back(arm + 3 * i, axes, t->corners + 3 * i);
        height[i] = 0;
        for (int j = 0; j < 3; j++) {
            arm[3 * i + j] -= t->radius[i] * up[j];
            height[i] += (site[j] + arm[3 * i + j]) * up[j];
        }
        low = i ? sf_min(low, height[i]) : height[i];
    }
    for (int i = 0; i < count; i++) {
        const sf_real *twist = posture->speeds + 9 + 6 * (i / t->points);
        sf_real weight = sf_exp(-(height[i] - low) / t->touch), turned[3];
        sf_cross(turned, twist, arm + 3 * i);
        for (int j = 0; j < 3; j++) sum[j] += weight * (twist[3 + j] + turned[j]);
        total += weight;
    }
    for (int j = 0; j < 3; j++) mean[j] = sum[j] / total;
}

/* Strapdown.advance: go on by one packet; rotation and velocity of the IMU at the middle since the last one. soles:
   what these show of the IMU's errors. */
SF_API void sf_advance(const sf_timing *t, sf_strapdown *s, const sf_posture *posture, const sf_odometry *soles,
                       sf_real *middle, sf_real *speed) {
    sf_real period = (sf_real)t->period, turn[3], small[9], end[9], rise[3], legs[3], by_legs[3], imu[3], next[3], off[3];
    const sf_real *force = posture->force, *bias = soles->force_bias;
    sf_real believed = 1 / (1 + sf_square(bias) / (t->zero_offset * t->zero_offset)), felt[3];
    for (int i = 0; i < 3; i++) felt[i] = force[i] - believed * bias[i];
    for (int i = 0; i < 3; i++) turn[i] = (posture->spin[i] - soles->spin_bias[i] - s->spin_bias[i]) * period;
    sf_small_rotation(turn, (sf_real)0.5, small);
    sf_then(middle, s->R, small);
    sf_small_rotation(turn, 1, small);
    sf_then(end, s->R, small);
    sf_turn(rise, middle, felt);
    rise[2] -= t->gravity + s->vertical_bias;
    sf_touching(t, posture, s->R + 6, legs);
    for (int i = 0; i < 3; i++) legs[i] = -legs[i];
    sf_turn(by_legs, middle, legs);
    sf_turn(imu, middle, posture->speeds + 6);
    for (int i = 0; i < 3; i++) next[i] = s->velocity[i] + rise[i] * period;
    if (sf_square(force) > sf_power2(SF_FREE_FALL * t->gravity)) {
        sf_real share, tilt[3], turned[9], moved[3];
        s->count++;
        share = sf_max(1 / (sf_real)s->count, period / t->leg_time);
        for (int i = 0; i < 3; i++) {
            off[i] = by_legs[i] + imu[i] - (sf_real)0.5 * (s->velocity[i] + next[i]);
            next[i] += share * off[i];
        }
        tilt[0] = t->tilt_rate * t->tilt_rate / t->gravity * period * -off[1];
        tilt[1] = t->tilt_rate * t->tilt_rate / t->gravity * period * off[0];
        tilt[2] = 0;
        sf_small_rotation(tilt, 1, small);
        sf_then(turned, small, end);
        sf_copy(end, turned, 9);
        sf_turn_back(moved, middle, tilt);
        for (int i = 0; i < 3; i++) s->spin_bias[i] -= moved[i] / t->bias_time;
        s->vertical_bias -= period / (t->leg_time * t->bias_time) * off[2];
    }
    for (int i = 0; i < 3; i++) {
        speed[i] = (sf_real)0.5 * (s->velocity[i] + next[i]);
        s->velocity[i] = next[i];
        s->place[i] += by_legs[i] * period;
    }
    /* _orthonormal: R <- 1.5 R - 0.5 R R' R */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) small[3 * i + j] = sf_dot(end + 3 * i, end + 3 * j, 3);
    sf_then(s->R, small, end);
    for (int i = 0; i < 9; i++) s->R[i] = (sf_real)1.5 * end[i] - (sf_real)0.5 * s->R[i];
}

/* RollingOdometry.turn: as sf_odometry_turn, by feet that are round. */
SF_API void sf_rolling_turn(const sf_timing *t, sf_odometry *s, const sf_posture *posture, sf_real *R) {
    sf_real speed[3];
    if (!s->count) sf_strapdown_begin(&s->rolling, posture->force);
    s->count++;
    sf_advance(t, &s->rolling, posture, s, R, speed);
}

#endif
