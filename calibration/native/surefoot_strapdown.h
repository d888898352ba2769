/* What one robot knows of its momentum, in C99: as surefoot_beliefs.h, for method "moment".

   The specification is the Python in robot/beliefs/momentum.py, whose module docstring derives it; constants come from
   there.

       sf_strapdown_config legs;            constants, written by surefoot.robot.beliefs.native
       sf_momentum_beliefs beliefs;         all that is remembered
       sf_momentum_beliefs_init(&beliefs);
       sf_momentum_packet(&model, &timing, &legs, &beliefs, number, arrival, angle, accelerometer, gyroscope);
       sf_momentum_sample(&timing, &beliefs, time, planned, hold, &belief);     once a sample of the feet */

#ifndef SUREFOOT_STRAPDOWN_H
#define SUREFOOT_STRAPDOWN_H

#include "surefoot_beliefs.h"

#ifndef SF_CORNERS
#define SF_CORNERS 16 /* of one sole */
#endif

/* Places of the vectors of a row, as in momentum.py. */
enum {
    SF_MOVED_COM = 0,
    SF_MOVED_SOLES = 3,
    SF_MOVED_AXES = 9,
    SF_MOVED_VELOCITY = 27,
    SF_MOVED_MOMENTUM = 30,
    SF_MOVED = 33
};

/* StrapdownConstants: constants by their names in Python. */
typedef struct {
    int points; /* of each sole, that may touch */
    sf_real leg_time, tilt_rate, zero_offset, bias_time, touch, free_fall;
    sf_real corners[2 * SF_CORNERS * 3];
} sf_strapdown_config;

/* MomentumBeliefs and its Strapdown. */
typedef struct {
    sf_beliefs beliefs;
    sf_real moved[SF_PACKETS * SF_MOVED];
    sf_real R[9], velocity[3], place[3], velocity_spin_bias[3], vertical_bias;
    sf_whole velocities;
} sf_momentum_beliefs;

/* Whether constants that come from elsewhere lie within the arrays. */
SF_API int sf_strapdown_fits(const sf_strapdown_config *k) { return k->points >= 1 && k->points <= SF_CORNERS; }

/* Strapdown: nothing is known. */
SF_API void sf_strapdown_init(sf_momentum_beliefs *s) {
    memset(s->R, 0, sizeof s->R);
    memset(s->velocity, 0, sizeof s->velocity);
    memset(s->place, 0, sizeof s->place);
    memset(s->velocity_spin_bias, 0, sizeof s->velocity_spin_bias);
    s->R[0] = s->R[4] = s->R[8] = 1;
    s->vertical_bias = 0;
    s->velocities = 0;
}

/* Before any packet. */
SF_API void sf_momentum_beliefs_init(sf_momentum_beliefs *s) {
    memset(s, 0, sizeof *s);
    sf_beliefs_init(&s->beliefs);
    sf_strapdown_init(s);
}

/* Strapdown.begin: begin with what the specific force of a robot at rest shows of up. */
SF_API void sf_strapdown_begin(sf_momentum_beliefs *s, const sf_real *force) {
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

/* touching: mean velocity of the soles' points that touch the ground, relative to the torso, in its axes.
   up: against gravity. */
SF_API void sf_touching(const sf_strapdown_config *k, const sf_posture *posture, const sf_real *up, sf_real *mean) {
    sf_real height[2 * SF_CORNERS], arm[2 * SF_CORNERS * 3], low = 0, total = 0, sum[3] = {0, 0, 0};
    for (int i = 0; i < 2 * k->points; i++) {
        int foot = i / k->points;
        const sf_real *axes = posture->local + SF_ROW_AXES + 9 * foot, *corner = k->corners + 3 * i;
        const sf_real *site = posture->local + SF_ROW_SOLES + 3 * foot;
        sf_turn_back(arm + 3 * i, axes, corner);
        height[i] = 0;
        for (int j = 0; j < 3; j++) height[i] += (site[j] + arm[3 * i + j]) * up[j];
        low = i ? sf_min(low, height[i]) : height[i];
    }
    for (int i = 0; i < 2 * k->points; i++) {
        const sf_real *twist = posture->speeds + 9 + 6 * (i / k->points);
        sf_real weight = sf_exp(-(height[i] - low) / k->touch), turned[3];
        sf_cross(turned, twist, arm + 3 * i);
        for (int j = 0; j < 3; j++) sum[j] += weight * (twist[3 + j] + turned[j]);
        total += weight;
    }
    for (int j = 0; j < 3; j++) mean[j] = sum[j] / total;
}

/* Strapdown.advance: go on by one packet; rotation and velocity of the IMU at the middle since the last one. */
SF_API void sf_advance(const sf_timing *t, const sf_strapdown_config *k, sf_momentum_beliefs *s, const sf_posture *posture,
                       sf_real *middle, sf_real *speed) {
    sf_real period = (sf_real)t->period, turn[3], small[9], end[9], rise[3], legs[3], by_legs[3], imu[3], next[3], off[3];
    const sf_real *force = posture->force, *bias = s->beliefs.force_bias;
    sf_real believed = 1 / (1 + sf_square(bias) / (k->zero_offset * k->zero_offset)), felt[3];
    for (int i = 0; i < 3; i++) felt[i] = force[i] - believed * bias[i];
    for (int i = 0; i < 3; i++) turn[i] = (posture->spin[i] - s->beliefs.spin_bias[i] - s->velocity_spin_bias[i]) * period;
    sf_small_rotation(turn, (sf_real)0.5, small);
    sf_then(middle, s->R, small);
    sf_small_rotation(turn, 1, small);
    sf_then(end, s->R, small);
    sf_turn(rise, middle, felt);
    rise[2] -= t->gravity + s->vertical_bias;
    sf_touching(k, posture, s->R + 6, legs);
    for (int i = 0; i < 3; i++) legs[i] = -legs[i];
    sf_turn(by_legs, middle, legs);
    sf_turn(imu, middle, posture->speeds + 6);
    for (int i = 0; i < 3; i++) next[i] = s->velocity[i] + rise[i] * period;
    if (sf_square(force) > sf_power2(k->free_fall * t->gravity)) {
        sf_real share, tilt[3], turned[9], moved[3];
        s->velocities++;
        share = sf_max(1 / (sf_real)s->velocities, period / k->leg_time);
        for (int i = 0; i < 3; i++) {
            off[i] = by_legs[i] + imu[i] - (sf_real)0.5 * (s->velocity[i] + next[i]);
            next[i] += share * off[i];
        }
        tilt[0] = k->tilt_rate * k->tilt_rate / t->gravity * period * -off[1];
        tilt[1] = k->tilt_rate * k->tilt_rate / t->gravity * period * off[0];
        tilt[2] = 0;
        sf_small_rotation(tilt, 1, small);
        sf_then(turned, small, end);
        sf_copy(end, turned, 9);
        sf_turn_back(moved, middle, tilt);
        for (int i = 0; i < 3; i++) s->velocity_spin_bias[i] -= moved[i] / k->bias_time;
        s->vertical_bias -= period / (k->leg_time * k->bias_time) * off[2];
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

/* MomentumBeliefs.update: take in one packet; arguments as of sf_beliefs_packet. */
SF_API void sf_momentum_packet(const sf_model *m, const sf_timing *t, const sf_strapdown_config *k, sf_momentum_beliefs *s,
                               sf_whole number, double arrival, const sf_real *angle, const sf_real *accelerometer,
                               const sf_real *gyroscope) {
    sf_posture posture;
    sf_real R[9], speed[3], local[SF_MOVED];
    if (!sf_sound(m, t, &s->beliefs, &number, angle, &accelerometer, &gyroscope)) return;
    if (!sf_take(m, t, &s->beliefs, number, arrival, angle, accelerometer, gyroscope, &posture)) {
        sf_strapdown_begin(s, accelerometer);
        return;
    }
    sf_advance(t, k, s, &posture, R, speed);
    sf_real *row = s->moved + SF_MOVED * sf_place(number);
    sf_copy(local + SF_MOVED_COM, posture.local + SF_ROW_COM, 3);
    sf_copy(local + SF_MOVED_SOLES, posture.local + SF_ROW_SOLES, 24);
    sf_copy(local + SF_MOVED_MOMENTUM, posture.local + SF_ROW_MOMENTUM, 3);
    for (int i = 0; i < 3; i++) local[SF_MOVED_VELOCITY + i] = posture.speeds[i] - posture.speeds[6 + i];
    for (int i = 0; i < SF_MOVED; i += 3) sf_turn(row + i, R, local + i);
    for (int i = 0; i < 3; i++) row[SF_MOVED_VELOCITY + i] += speed[i];
    for (int i = 0; i < SF_MOVED_AXES; i++) row[i] += s->place[i % 3];
}

/* MomentumBeliefs.momentum: what the robot believed of a moment, with the contacts that stand in `out`. */
SF_API void sf_momentum_reference(const sf_timing *t, const sf_momentum_beliefs *s, double time, sf_belief *out) {
    const sf_beliefs *beliefs = &s->beliefs;
    sf_reference *r = &out->reference;
    unsigned char found[4];
    sf_real rows[SF_MOVED];
    memcpy(found, r->stance, 2);
    memcpy(found + 2, r->swing, 2);
    sf_nothing(out);
    r->momentum = 1;
    if (beliefs->run > 1) {
        /* A reading stands for the middle of its interval, a momentum for the end. */
        sf_interpolate(t, beliefs, s->moved, SF_MOVED, time + 0.5 * (double)t->dt,
                       beliefs->number - sf_rows_kept(beliefs) + 1, beliefs->number, rows);
        sf_put_reference(r, rows + SF_MOVED_COM, rows + SF_MOVED_VELOCITY, rows + SF_MOVED_MOMENTUM,
                         rows + SF_MOVED_SOLES, rows + SF_MOVED_AXES);
    }
    memcpy(r->stance, found, 2);
    memcpy(r->swing, found + 2, 2);
    out->known = r->com[0] == r->com[0];
}

/* MomentumBeliefs.sample: what the robot believes for one sample of its feet; arguments as of sf_beliefs_sample. */
SF_API void sf_momentum_sample(const sf_timing *t, sf_momentum_beliefs *s, double time, const unsigned char *planned,
                               int hold, sf_belief *out) {
    sf_beliefs_sample(t, &s->beliefs, time, planned, hold, out);
    if (out->known && s->beliefs.run > 1) {
        sf_momentum_reference(t, s, time, out);
        return;
    }
    sf_nothing(out);
    out->reference.momentum = 1;
}

#endif
