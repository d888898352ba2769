/* Attitude and velocity of one robot, in C99: one filter of its IMU and the legs that stand.

   The specification is the Python in robot/beliefs/strapdown.py, whose module docstring derives it.

   Before it is included: SF_CORNERS is the largest number of parts of a foot that may touch; for what
   surefoot_nominal.h takes see there. */

#ifndef SUREFOOT_ODOMETRY_H
#define SUREFOOT_ODOMETRY_H

#include "surefoot_nominal.h"

#ifndef SF_CORNERS
#define SF_CORNERS 16
#endif

/* Places of a row's vectors behind those of sf_row_own. Acceleration and rate follow from neighbours in time. */
enum {
    SF_OWN_MOMENTUM = 0,
    SF_OWN_FORCE = 3,
    SF_OWN_ACCELERATION = 6,
    SF_OWN_RATE = 9,
    SF_OWN_GROUND = 12,
    SF_OWN_ACCELEROMETER = 15,
    SF_OWN_GYROSCOPE = 18,
    SF_OWN = 21
};
#define SF_ROW (SF_ROW_SOLES + 12 * SF_FEET + SF_OWN) /* the widest one */

#define SF_FREE_FALL ((sf_real)0.5) /* of gravity, as in contacts.py */

/* ------------------------------------------------------------------------------------------------ records */

/* When packets leave and samples are taken, what of the feet may touch, and StrapdownConstants by their names. */
typedef struct {
    int averaged;       /* whether a sample of the IMU is the mean since the packet before */
    int joined;         /* how many packets become one, of which the period is */
    int filled;         /* longest gap in packets that is filled in */
    int needed, window; /* contacts.planned_window: for how long a plan must have held, and what is kept */
    int feet, points;   /* and how many parts of each may touch */
    int rolls;          /* whether feet are round, so that they stand on any of their sides */
    sf_real dt, gravity; /* time between samples of the feet in s; m/s^2 */
    sf_real legs_noise, legs_speed, outlying, velocity_noise, tilt_noise, bias_noise;
    sf_real first_velocity, first_tilt, first_bias, turned, known_tilt;
    sf_real vertical_bias_time, ground_time, rest_time, first_time, force_bias_time, zero_offset, touch, no_normal;
    sf_real sole_height, other_ground, still_velocity, still_tilt, still_spin, still_speed, still_force, contradiction;
    sf_real corners[SF_FEET * SF_CORNERS * 3], radius[SF_FEET * SF_CORNERS]; /* centres in the sole frames; m */
    double period, delay; /* time between packets and their mean delay in s */
} sf_timing;

/* Strapdown; covariance: of velocity, tilt and gyroscope bias along a horizontal axis. */
typedef struct {
    sf_real R[9], velocity[3], place[3], spin_bias[3], vertical_bias;
    sf_real ground[3], excess[3], sole_bias[3], force_bias[3], covariance[9];
    sf_whole count;
} sf_strapdown;

/* Posture: the robot at the middle between two packets, in the torso's axes, as sf_evaluate leaves it; and the rotation
   from these axes and the IMU's velocity, by the attitude filter. */
typedef struct {
    sf_real local[SF_ROW], speeds[3 + 6 * (1 + SF_FEET)], force[3], spin[3], R[9], velocity[3];
} sf_posture;

/* Before any packet. The covariance begins with the first one. */
SF_API void sf_strapdown_init(sf_strapdown *s) {
    memset(s, 0, sizeof *s);
    s->R[0] = s->R[4] = s->R[8] = s->ground[2] = 1;
}

/* ----------------------------------------------------------------------------------------------- attitude */

/* Set the covariance to one without correlations, by its standard deviations. */
SF_API void sf_uncertain(sf_strapdown *s, sf_real velocity, sf_real tilt, sf_real bias) {
    memset(s->covariance, 0, sizeof s->covariance);
    s->covariance[0] = velocity * velocity, s->covariance[4] = tilt * tilt, s->covariance[8] = bias * bias;
}

/* Strapdown.coast: keep the attitude over a gap, and become less certain; negative seconds are any time. */
SF_API void sf_coast(const sf_timing *t, sf_strapdown *s, double seconds) {
    sf_real turned = t->turned * (sf_real)seconds, tilt = sf_sqrt(s->covariance[4] + turned * turned);
    sf_uncertain(s, t->first_velocity, seconds > 0 ? sf_min(tilt, t->first_tilt) : t->first_tilt, sf_sqrt(s->covariance[8]));
}

/* Strapdown.known: whether the attitude is good enough for references. */
SF_API int sf_attitude_known(const sf_timing *t, const sf_strapdown *s) {
    return s->covariance[4] < t->known_tilt * t->known_tilt;
}

/* _upright: rotation of a torso at rest, whose specific force points up. */
SF_API void sf_put_upright(sf_real *R, const sf_real *force) {
    sf_real *forward = R, *left = R + 3, *up = R + 6, by = 1 / sf_sqrt(sf_square(force));
    for (int k = 0; k < 3; k++) up[k] = force[k] * by;
    int axis = sf_fabs(up[0]) < (sf_real)0.9 ? 0 : 2;
    for (int k = 0; k < 3; k++) forward[k] = (sf_real)(k == axis) - up[axis] * up[k];
    sf_unit_vector(forward);
    sf_cross(left, up, forward);
}

/* Strapdown._find_ground: turn the ground's normal on, and correct it by the soles that are lowest along it. */
SF_API void sf_find_ground(const sf_timing *t, sf_strapdown *s, const sf_real *turn, const sf_real *local) {
    int F = t->feet;
    sf_real moved[3], ground[3], height[SF_FEET], weight[SF_FEET], total = 0, share, length;
    if (t->rolls) {
        sf_copy(s->ground, s->R + 6, 3);
        return;
    }
    sf_cross(moved, turn, s->ground);
    for (int k = 0; k < 3; k++) ground[k] = s->ground[k] - moved[k];
    for (int i = 0; i < F; i++) weight[i] = 1, height[i] = sf_dot(local + SF_ROW_SOLES + 3 * i, ground, 3);
    for (int i = 0; i < F; i++) {
        for (int j = i + 1; j < F; j++) {
            sf_real beats = (sf_real)0.5 * sf_clip(1 - (height[i] - height[j]) / t->sole_height, 0, 2);
            weight[i] *= beats, weight[j] *= 1 - beats;
        }
        total += weight[i];
    }
    share = sf_max(1 / (sf_real)(s->count > 1 ? s->count : 1), (sf_real)t->period / t->ground_time);
    for (int k = 0; k < 3; k++) {
        sf_real up = 0;
        for (int i = 0; i < F; i++) up += weight[i] * local[sf_row_axes(F) + 9 * i + 6 + k];
        ground[k] += share * (up / total - ground[k]);
    }
    length = sf_sqrt(sf_square(ground));
    for (int k = 0; length > t->no_normal && k < 3; k++) s->ground[k] = ground[k] / length;
}

/* Strapdown._judge: set how certain the attitude is where the robot is at rest. */
SF_API void sf_judge_attitude(const sf_timing *t, sf_strapdown *s, const sf_real *force, const sf_real *spin,
                              const sf_real *legs) {
    sf_real length = sf_sqrt(sf_square(force));
    if (!(sf_square(spin) < sf_power2(t->still_spin) && sf_square(legs) < sf_power2(t->still_speed) &&
          sf_fabs(length - t->gravity) < t->still_force * t->gravity))
        return;
    if (s->count == 1) sf_uncertain(s, t->still_velocity, t->still_tilt, t->first_bias);
    else if (sf_attitude_known(t, s) && (sf_real)s->count * (sf_real)t->period < t->first_time &&
             sf_dot(s->R + 6, force, 3) < sf_cos(t->contradiction) * length)
        sf_coast(t, s, -1);
}

/* Strapdown._slope: square of the part of a specific force along the ground. */
SF_API sf_real sf_slope(const sf_strapdown *s, const sf_real *force) {
    return sf_square(force) - sf_power2(sf_dot(force, s->ground, 3));
}

/* Strapdown._find_bias: compare the specific force with the normal of the ground, if soles show it. */
SF_API void sf_find_bias(const sf_timing *t, sf_strapdown *s, const sf_real *force) {
    sf_real period = (sf_real)t->period, count = (sf_real)s->count, off[3], weight, share, believed;
    if (t->rolls) return;
    share = sf_max(1 / count, period / t->rest_time);
    for (int k = 0; k < 3; k++) {
        s->excess[k] += share * (force[k] - t->gravity * s->ground[k] - s->excess[k]);
        off[k] = s->excess[k] - s->sole_bias[k];
    }
    weight = 1 / sf_power2(1 + sf_slope(s, off) / (t->other_ground * t->other_ground));
    share = period / sf_min(t->first_time + count * period, t->force_bias_time);
    for (int k = 0; k < 3; k++) s->sole_bias[k] += share * weight * off[k];
    believed = 1 / (1 + sf_slope(s, s->sole_bias) / (t->zero_offset * t->zero_offset));
    for (int k = 0; k < 3; k++) s->force_bias[k] = s->sole_bias[k] * believed;
}

/* _rotation: by a vector in rad (Rodrigues). */
SF_API void sf_rotation_by(const sf_real *turn, sf_real factor, sf_real *R) {
    sf_real a[3] = {factor * turn[0], factor * turn[1], factor * turn[2]}, angle = sf_sqrt(sf_square(a));
    sf_real cross[9] = {0, -a[2], a[1], a[2], 0, -a[0], -a[1], a[0], 0}, square[9], first = 1, second = (sf_real)0.5;
    if (angle > (sf_real)1e-3) first = sf_sin(angle) / angle, second = (1 - sf_cos(angle)) / (angle * angle);
    sf_then(square, cross, cross);
    for (int i = 0; i < 9; i++) R[i] = (sf_real)(i % 4 == 0) + first * cross[i] + second * square[i];
}

/* touching: mean velocity of the feet's points that touch the ground, relative to the torso, in its axes.
   up: normal of the ground. */
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

/* P <- F P F' + Q of the errors of velocity, tilt and gyroscope bias over one packet. */
SF_API void sf_grow(const sf_timing *t, sf_real *P) {
    sf_real period = (sf_real)t->period, drift = period * t->gravity, square = t->gravity * t->gravity, next[9];
    sf_real F[9] = {1, drift, (sf_real)0.5 * drift * period, 0, 1, period, 0, 0, 1};
    sf_then(next, F, P);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) P[3 * i + j] = sf_dot(next + 3 * i, F + 3 * j, 3);
    P[0] += period * t->velocity_noise;
    P[4] += period * t->tilt_noise / square;
    P[8] += period * t->bias_noise / square;
}

/* Strapdown.advance: take in the middle between two packets; fills the posture's rotation and velocity of the IMU. */
SF_API void sf_advance(const sf_timing *t, sf_strapdown *s, sf_posture *posture) {
    sf_real period = (sf_real)t->period, turn[3], small[9], end[9], rise[3], legs[3], by_legs[3], imu[3], before[3], after[3];
    sf_real felt[3], *P = s->covariance, *middle = posture->R;
    const sf_real *force = posture->force;
    int carried = sf_square(force) > sf_power2(SF_FREE_FALL * t->gravity);
    if (P[8] == 0) sf_uncertain(s, t->first_velocity, t->first_tilt, t->first_bias);
    s->count += carried;
    if (carried && s->count == 1) sf_put_upright(s->R, force);
    for (int i = 0; i < 3; i++) turn[i] = (posture->spin[i] - s->spin_bias[i]) * period;
    sf_find_ground(t, s, turn, posture->local);
    sf_rotation_by(turn, (sf_real)0.5, small);
    sf_then(middle, s->R, small);
    sf_rotation_by(turn, 1, small);
    sf_then(end, s->R, small);
    sf_touching(t, posture, s->ground, legs);
    for (int i = 0; i < 3; i++) legs[i] = -legs[i], felt[i] = force[i] - s->force_bias[i];
    sf_judge_attitude(t, s, force, posture->spin, legs);
    sf_turn(by_legs, middle, legs);
    sf_turn(imu, middle, posture->speeds + 6);
    sf_turn(rise, middle, felt);
    rise[2] -= t->gravity + s->vertical_bias;
    for (int i = 0; i < 3; i++) {
        before[i] = s->count > 1 ? s->velocity[i] : by_legs[i] + imu[i] - (sf_real)0.5 * period * rise[i];
        after[i] = before[i] + rise[i] * period;
        posture->velocity[i] = (sf_real)0.5 * before[i];
    }
    sf_grow(t, P);
    if (carried) {
        sf_real off[3], gain[3], row[3] = {P[0], P[1], P[2]}, across[3], turned[9], moved[3], doubt, usual;
        for (int i = 0; i < 3; i++) off[i] = by_legs[i] + imu[i] - (sf_real)0.5 * (before[i] + after[i]);
        usual = 3 * (row[0] + t->legs_speed * t->legs_speed);
        doubt = (off[0] * off[0] + off[1] * off[1] + off[2] * off[2]) / (t->outlying * t->outlying * usual);
        if (doubt < 1) doubt = 1;
        for (int i = 0; i < 3; i++) gain[i] = row[i] / (row[0] + doubt * t->legs_noise / period);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) P[3 * i + j] -= gain[i] * row[j];
        for (int i = 0; i < 3; i++) after[i] += gain[0] * off[i];
        across[0] = -off[1], across[1] = off[0], across[2] = 0;
        sf_rotation_by(across, gain[1], small);
        sf_then(turned, small, end);
        sf_copy(end, turned, 9);
        sf_turn_back(moved, middle, across);
        for (int i = 0; i < 3; i++) s->spin_bias[i] -= gain[2] * moved[i];
        s->vertical_bias -= gain[0] / t->vertical_bias_time * off[2];
        sf_find_bias(t, s, force);
    }
    for (int i = 0; i < 3; i++) {
        posture->velocity[i] += (sf_real)0.5 * after[i];
        s->velocity[i] = after[i];
        s->place[i] += by_legs[i] * period;
    }
    /* _orthonormal: R <- 1.5 R - 0.5 R R' R */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) small[3 * i + j] = sf_dot(end + 3 * i, end + 3 * j, 3);
    sf_then(s->R, small, end);
    for (int i = 0; i < 9; i++) s->R[i] = (sf_real)1.5 * end[i] - (sf_real)0.5 * s->R[i];
}

#endif
