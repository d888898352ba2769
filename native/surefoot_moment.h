/* The moment filter of one robot's feet in C99, one step a sample.

   The specification is the Python in calibration/moment, whose config.py derives it. A function here has the name of
   the Python function that it is equal to, and tests hold the two together; constants come from there and nowhere else.

       sf_config robot; sf_moment_config moment;        constants, written by surefoot.calibration.native.c_source
       sf_moment_state state;                           all that is remembered, a plain record that may be copied
       sf_moment_work work;                             of which nothing is remembered
       sf_moment_init(&robot, &moment, &state, &work);
       sf_moment_step(&robot, &moment, &state, &work, raw, &reference, dt, &estimate);      once a sample

   Numbers are doubles: what a zero has drifted is known a million times better at first than what a scale is.

   Before it is included: SF_COMPONENTS is 3 where no foot sees forces along the sole, and SF_BLOCK the most samples of
   a block, besides what surefoot_robot.h takes. */

#ifndef SUREFOOT_MOMENT_H
#define SUREFOOT_MOMENT_H

#include "surefoot_robot.h"

#ifndef SF_COMPONENTS
#define SF_COMPONENTS 6
#endif
#ifndef SF_TALKS
#define SF_TALKS 60 /* fifteen for each six-axis sensor, 0 for cells alone */
#endif
#ifndef SF_BLOCK
#define SF_BLOCK 48
#endif

#define SF_MODES 3
#define SF_SEVERITIES 4 /* of scales, and as many of offsets */
#define SF_WEIGHED (3 * SF_CHANNELS)
#define SF_JUDGED (2 * SF_CHANNELS) /* scales and offsets, which severities differ in */
#define SF_KNOWN (SF_WEIGHED + SF_TALKS + 4)
#define SF_STATES (SF_KNOWN + 2 * SF_COMPONENTS)
#define SF_WAITING (2 * SF_CHANNELS + 13 + 13 * SF_FEET)
#define SF_AT_ONCE (SF_CHANNELS > SF_COMPONENTS ? SF_CHANNELS : SF_COMPONENTS) /* rows */
#define SF_SUSPECTS (2 * SF_CHANNELS + SF_CHANNELS * (SF_CHANNELS - 1))

/* Logarithm of shares of a mixture that change no digit of it. */
#define SF_LITTLE -34

/* ------------------------------------------------------------------------------------------------ records */

/* Constants by their names in Python: of filter.py, model.py, tare.py, severity.py, health.py, modes.py, motion.py. */
typedef struct {
    int components, capacity, held, steady, talks, carries;
    sf_real below[SF_CHANNELS * 3], com_below[SF_FEET * 3]; /* Blocks: W by m/s^2; m */
    int talk_to[SF_TALKS + 1], talk_from[SF_TALKS + 1]; /* channels that may show another's load, and those of it */
    sf_real first_variance[SF_STATES], walk[2 * SF_CHANNELS], block, ahead, kept_time, longest_pause, product_time;
    sf_real largest_error, level, least_read, held_chance;
    sf_real velocity_variance[3], spin_variance, ripple, least_load, least_cosine;
    sf_real tilt_memory, tilt_noise, tilt_mean, tilt_std;
    sf_real tare_variance[SF_CHANNELS], tare_share, least_apart, rate_share, smallest_rate;
    sf_real largest_rate, tare_surprise, stated_rate, first_rate, tare_leap, largest_load, largest_tared;
    sf_real loaded[SF_CHANNELS], rough_density, noise_spread, zero_jump, unconfirmed, roughest;
    sf_real level_time, least_still;
    sf_real spread_scale[SF_CHANNELS], spread_offset[SF_CHANNELS], unit[SF_CHANNELS];
    sf_real severities[SF_SEVERITIES], likely[SF_SEVERITIES], wide, least_narrower;
    sf_real most_load, least_row, reading_noise;
    sf_real mode_time[SF_MODES], mode_force[SF_MODES], mode_torque[SF_MODES];
    sf_real rates[SF_MODES * SF_MODES], first_chance[SF_MODES], least_chance, least_published;
    sf_real leg_time, spin_time, first_speed, fastest;
    sf_real versus_slack[SF_COMPONENTS], versus_factor, versus_explained, versus_memory, versus_independent, versus_sure;
    sf_real sure, contrast, alike, smallest_step, least_error, suspect_share, suspect_noise[2], suspect_surprise;
} sf_moment_config;

/* Belief: what the modes hold, and how likely they are. */
typedef struct {
    sf_real mean[SF_MODES * SF_STATES], covariance[SF_MODES * SF_STATES * SF_STATES], chance[SF_MODES];
    sf_real com_shift[2];
} sf_modes;

/* Publication: what is handed out. */
typedef struct {
    sf_real mean[SF_WEIGHED], covariance[SF_WEIGHED * SF_WEIGHED], undetermined[SF_CHANNELS];
} sf_publication;

/* TareState */
typedef struct {
    sf_real reading[SF_CHANNELS], moved[SF_CHANNELS], time[SF_FEET], sure[SF_FEET];
    sf_real offered[SF_CHANNELS], offer[SF_FEET], rough[SF_FEET], rate;
    sf_whole followed;
} sf_tares;

/* StillState */
typedef struct {
    sf_real reading[SF_CHANNELS], level[SF_CHANNELS], time;
} sf_still;

/* Kept, one of two */
typedef struct {
    sf_modes belief;
    sf_publication published;
    sf_tares tare;
} sf_known_then;

/* Track: where the axes of the last sample lie, and what was added up. */
typedef struct {
    sf_real motion[SF_MOTION];
    sf_whole samples;
    sf_real heading, origin[3], velocity[3], spin[3], adrift;
} sf_track;

/* SuspectState */
typedef struct {
    sf_real score[SF_SUSPECTS], before[SF_COMPONENTS], error[SF_COMPONENTS], noise[SF_COMPONENTS];
    sf_real known[SF_KNOWN], force[(2 * SF_BLOCK + 2) * SF_CHANNELS];
} sf_suspects;

/* VersusStartState */
typedef struct {
    sf_real time, learnt_mean[SF_COMPONENTS], learnt_square[SF_COMPONENTS];
    sf_real start_mean[SF_COMPONENTS], start_square[SF_COMPONENTS], precision[SF_COMPONENTS], evidence;
} sf_versus_start;

/* TiltState */
typedef struct {
    sf_real shift[2], time;
} sf_tilt;

/* Leap */
typedef struct {
    sf_real reading[SF_CHANNELS], std[SF_CHANNELS];
} sf_leap;

/* MomentState */
typedef struct {
    sf_front front;
    sf_track track;
    sf_channel_faults faults;
    sf_real pending[SF_BLOCK * SF_WAITING], before[SF_WAITING];
    sf_whole waiting, linked;
    sf_real point[3], time, drifted;
    sf_tares tare;
    sf_still still;
    sf_suspects suspects;
    sf_versus_start versus_start;
    sf_tilt tilt;
    sf_real shift[SF_CHANNELS];
    sf_modes belief;
    sf_publication published;
    sf_real covariance[4 * SF_CHANNELS * SF_CHANNELS];
    sf_known_then kept, next;
    sf_real age;
    sf_whole status;
} sf_moment_state;

/* Rows: what a block does to the momentum, and what measures it. */
typedef struct {
    sf_real mean[SF_COMPONENTS * SF_STATES], mean_rest[SF_COMPONENTS];
    sf_real end[SF_COMPONENTS * SF_STATES], end_rest[SF_COMPONENTS];
    sf_real measured[SF_COMPONENTS], at_end[SF_COMPONENTS];
    sf_real variance[SF_COMPONENTS * SF_COMPONENTS], walk[SF_COMPONENTS * SF_COMPONENTS], lasting[SF_COMPONENTS];
    sf_real crossed[SF_COMPONENTS * SF_CHANNELS * SF_CHANNELS];
    sf_real point[3], velocity[3], duration, height, tilt[2]; /* tilt: NaN where it is unknown */
} sf_moment_rows;

/* The severities against the data of one mode, in standard deviations of the wide prior: number 4 * k + l is of the
   severity l of offsets. */
typedef struct {
    sf_real U[4 * SF_CHANNELS * (SF_JUDGED + 1)], V[16 * SF_CHANNELS * (SF_CHANNELS + 1)]; /* see sf_compare */
    sf_real weight[16], evidence; /* of each severity, and of all together */
    int place[4], pair[16], count; /* where severities of offsets are in U, and which severities are in V */
} sf_compared;

typedef struct {
    sf_modes belief, mixed;
    sf_moment_rows rows;
    sf_leap leap;
    sf_compared compared[SF_MODES];
    sf_real std[SF_JUDGED], per_std[SF_JUDGED], own[SF_SEVERITIES * SF_JUDGED]; /* of priors */
    sf_real ahead[16]; /* logarithms of how likely severities are, and of what a measurement finds at first */
    sf_real A[SF_STATES * SF_STATES], B[SF_STATES * SF_STATES], R[SF_JUDGED * SF_JUDGED];
    sf_real S[4 * SF_CHANNELS * (SF_CHANNELS + 1)], T[4 * SF_CHANNELS * SF_CHANNELS], G[4 * SF_CHANNELS * SF_CHANNELS];
    sf_real F[4 * SF_CHANNELS * SF_CHANNELS], X[4 * SF_CHANNELS * (SF_CHANNELS + 1)], found[16 * SF_JUDGED];
    sf_real unit[SF_BLOCK * SF_COMPONENTS * SF_CHANNELS], force[SF_BLOCK * SF_CHANNELS];
    sf_publication published;
} sf_moment_work;

/* Where parts of the unknowns stand: scales from 0 on. */
SF_API int sf_coms(const sf_config *c, const sf_moment_config *m) { return 3 * c->channels + m->talks; }
SF_API int sf_weighed(const sf_config *c) { return 3 * c->channels; }
SF_API int sf_momenta(const sf_config *c, const sf_moment_config *m) { return sf_coms(c, m) + 4; }
SF_API int sf_states(const sf_config *c, const sf_moment_config *m) { return sf_momenta(c, m) + 2 * m->components; }

/* Where parts of a sample stand that waits: forces in W and whether they were read first. */
SF_API int sf_at_end(const sf_config *c) { return 2 * c->channels; }
SF_API int sf_at_com(const sf_config *c) { return 2 * c->channels + 3; }
SF_API int sf_at_velocity(const sf_config *c) { return 2 * c->channels + 6; }
SF_API int sf_at_spin(const sf_config *c) { return 2 * c->channels + 9; }
SF_API int sf_at_sole(const sf_config *c) { return 2 * c->channels + 12; }
SF_API int sf_at_rotation(const sf_config *c) { return 2 * c->channels + 12 + 3 * c->feet; }
SF_API int sf_at_swing(const sf_config *c) { return 2 * c->channels + 12 + 12 * c->feet; }
SF_API int sf_at_dt(const sf_config *c) { return 2 * c->channels + 12 + 13 * c->feet; }
SF_API int sf_waiting(const sf_config *c) { return 2 * c->channels + 13 + 13 * c->feet; }

/* Return whether a robot fits into the arrays; call it once for constants that come from elsewhere. */
SF_API int sf_moment_fits(const sf_config *c, const sf_moment_config *m) {
    return sizeof(sf_real) == sizeof(double) && sf_robot_fits(c) && (m->components == 3 || m->components == 6) &&
           m->components <= SF_COMPONENTS && m->talks >= 0 && m->talks <= SF_TALKS && m->capacity >= 1 && m->capacity <= SF_BLOCK && m->held >= 0 &&
           m->held < SF_MODES;
}

/* ------------------------------------------------------------------------------------------------- motion */

/* Track.begin */
SF_API void sf_track_begin(const sf_moment_config *m, sf_track *s) {
    memset(s, 0, sizeof *s);
    s->adrift = m->leg_time;
}

/* Of a sample: where the robot was while it was taken. Pose. */
typedef struct {
    sf_real end[3], com[3], sole[3 * SF_FEET], rotation[9 * SF_FEET];
} sf_pose;

/* follow_momentum */
SF_API void sf_follow_momentum(const sf_config *c, sf_track *s, const sf_real *motion, sf_pose *pose) {
    int R = sf_motion(c);
    sf_real middle[SF_MOTION];
    for (int i = 0; i < R; i++)
        middle[i] = s->samples == 0 ? motion[i] : (sf_real)0.5 * (motion[i] + s->motion[i]);
    sf_copy(s->motion, motion, R);
    s->samples++;
    s->heading = s->adrift = 0;
    for (int k = 0; k < 3; k++) {
        s->origin[k] = 0;
        s->velocity[k] = motion[SF_ACCELERATION + k];
        s->spin[k] = motion[SF_RATE + k] / c->mass;
    }
    sf_copy(pose->end, motion + SF_COM, 3);
    sf_copy(pose->com, middle + SF_COM, 3);
    sf_copy(pose->sole, sf_position(middle, 0), 3 * c->feet);
    sf_copy(pose->rotation, sf_rotation(c, middle, 0), 9 * c->feet);
}

/* out = a vector turned about the vertical */
SF_API void sf_about_z(sf_real *out, sf_real angle, const sf_real *v) {
    sf_real cosine = (sf_real)cos(angle), sine = (sf_real)sin(angle);
    out[0] = cosine * v[0] - sine * v[1], out[1] = sine * v[0] + cosine * v[1], out[2] = v[2];
}

/* follow_accelerations */
SF_API void sf_follow_accelerations(const sf_config *c, const sf_moment_config *m, sf_track *s, const sf_real *motion,
                                    const unsigned char *stance, sf_real dt, sf_pose *pose) {
    int F = c->feet, standing = 0, still[SF_FEET], count = 0;
    const sf_real *sole = sf_position(motion, 0), *rotation = sf_rotation(c, motion, 0);
    sf_copy(pose->sole, sole, 3 * F);
    sf_copy(pose->rotation, rotation, 9 * F);
    for (int foot = 0; foot < F; foot++) standing = standing || stance[foot];
    if (s->adrift >= m->leg_time) {
        sf_track_begin(m, s);
        sf_copy(s->motion, motion, sf_motion(c));
        s->samples = 1;
        if (standing) s->adrift = 0;
        sf_copy(pose->end, motion + SF_COM, 3);
        sf_copy(pose->com, motion + SF_COM, 3);
        return;
    }
    const sf_real *old_sole = sf_position(s->motion, 0), *old_rotation = sf_rotation(c, s->motion, 0);
    sf_real least = 0, forward[2] = {0, 0}, before[2] = {0, 0}, heading, origin[3] = {0, 0, 0}, com[3], turned[3];
    for (int foot = 0; foot < F; foot++) {
        sf_real height = sole[3 * foot + 2] + old_sole[3 * foot + 2];
        least = foot ? sf_min(least, height) : height;
    }
    for (int foot = 0; foot < F; foot++) {
        still[foot] = standing ? stance[foot] : sole[3 * foot + 2] + old_sole[3 * foot + 2] == least;
        for (int k = 0; still[foot] && k < 2; k++) {
            forward[k] += rotation[9 * foot + 3 * k];
            before[k] += old_rotation[9 * foot + 3 * k];
        }
        count += still[foot];
    }
    heading = s->heading + (sf_real)atan2(before[1], before[0]) - (sf_real)atan2(forward[1], forward[0]);
    for (int foot = 0; foot < F; foot++) {
        if (!still[foot]) continue;
        sf_real now[3], then[3];
        sf_about_z(then, s->heading, old_sole + 3 * foot);
        sf_about_z(now, heading, sole + 3 * foot);
        for (int k = 0; k < 3; k++) origin[k] += (then[k] + s->origin[k] - now[k]) / (sf_real)count;
    }
    sf_about_z(com, heading, motion + SF_COM);
    sf_about_z(turned, heading, motion + SF_ACCELERATION);
    for (int k = 0; k < 3; k++) com[k] += origin[k], s->velocity[k] += turned[k] * dt;
    if (standing) {
        sf_real n = (sf_real)s->samples, share = sf_max(1 / n, dt / m->leg_time);
        sf_about_z(turned, s->heading, s->motion + SF_COM);
        for (int k = 0; k < 3; k++) {
            sf_real off = (com[k] - (turned[k] + s->origin[k])) / dt - s->velocity[k];
            s->velocity[k] += share * off / (1 + (off / m->first_speed) * (off / m->first_speed));
        }
    }
    sf_about_z(turned, heading, motion + SF_RATE);
    for (int k = 0; k < 3; k++) s->spin[k] += (turned[k] / c->mass - s->spin[k] / m->spin_time) * dt;
    s->samples++;
    s->adrift = standing ? 0 : s->adrift + dt;
    s->heading = heading;
    sf_copy(s->origin, origin, 3);
    for (int foot = 0; foot < F; foot++) {
        sf_about_z(pose->sole + 3 * foot, heading, sole + 3 * foot);
        for (int k = 0; k < 3; k++) {
            const sf_real *R = rotation + 9 * foot;
            sf_real axis[3] = {R[k], R[3 + k], R[6 + k]};
            pose->sole[3 * foot + k] += origin[k];
            sf_about_z(turned, heading, axis);
            for (int i = 0; i < 3; i++) pose->rotation[9 * foot + 3 * i + k] = turned[i];
        }
    }
    sf_copy(pose->end, com, 3);
    sf_copy(pose->com, com, 3);
    sf_copy(s->motion, motion, sf_motion(c));
}

/* plausible */
SF_API int sf_track_plausible(const sf_moment_config *m, const sf_track *s) {
    int good = 1;
    for (int k = 0; k < 3; k++)
        good = good && sf_fabs(s->velocity[k]) < m->fastest && sf_fabs(s->spin[k]) < m->fastest &&
               sf_finite(s->origin[k]);
    return good;
}

/* -------------------------------------------------------------------------------------------------- model */

/* Components of (force, torque) in the order of the momentum. */
SF_API int sf_component(int row) {
    static const int order[6] = {2, 3, 4, 0, 1, 5};
    return order[row];
}

/* Whether a component is a force. */
SF_API int sf_is_force(int row) { return row == 0 || row == 3 || row == 4; }

/* Model._point and _of_channels: o, and in w->unit what a unit of each channel does about it, shape (n, C, K); `mean` is
   that over the block, shape (C, K). spare: how forces are made of others where a channel is out, or NULL. */
SF_API void sf_units(const sf_config *c, const sf_moment_config *m, const sf_real *samples, int n, const sf_real *spare,
                     sf_real *mean, sf_moment_work *w) {
    int K = c->channels, C = m->components, wide = sf_waiting(c);
    sf_real total = 0, x = 0, y = 0, T = 0, *point = w->rows.point, height = 0;
    for (int t = 0; t < n; t++) {
        const sf_real *row = samples + t * wide, *sole = row + sf_at_sole(c), *rotation = row + sf_at_rotation(c);
        sf_real dt = row[sf_at_dt(c)], *unit = w->unit + t * C * K, low = sole[2];
        for (int foot = 1; foot < c->feet; foot++) low = sf_min(low, sole[3 * foot + 2]);
        height += low;
        T += dt;
        for (int i = 0; i < K; i++) {
            int foot = c->foot_of_channel[i];
            const sf_real *R = rotation + 9 * foot, *at = sole + 3 * foot, *map = c->wrench_map + foot * 6 * K + i;
            sf_real own[3] = {map[0], map[K], map[2 * K]}, torque[3] = {map[3 * K], map[4 * K], map[5 * K]};
            sf_real force = spare ? sf_dot(spare + i * K, w->force + t * K, K) : w->force[t * K + i];
            sf_real by = dt * force, part[6], moved[3];
            sf_turn(part, R, own);
            sf_turn(part + 3, R, torque);
            total += by * part[2];
            x += by * (at[0] * part[2] - part[4]);
            y += by * (at[1] * part[2] + part[3]);
            if (C == 3) { /* Model._of_cells: the mean force of the ground is vertical, also under a leaning sole */
                sf_real cosine = sf_max(R[8], m->least_cosine);
                part[2] = own[2] / cosine;
                part[3] = (at[1] * own[2] - R[3] * torque[1] + R[4] * torque[0]) / cosine;
                part[4] = -(at[0] * own[2] - R[0] * torque[1] + R[1] * torque[0]) / cosine;
            } else {
                sf_cross(moved, at, part);
                for (int k = 0; k < 3; k++) part[3 + k] += moved[k];
            }
            for (int r = 0; r < C; r++) unit[r * K + i] = part[sf_component(r)];
        }
    }
    sf_real least = sf_max(total, m->least_load * T);
    point[0] = x / least, point[1] = y / least, point[2] = height / (sf_real)n;
    w->rows.duration = T;
    for (int t = 0; t < n; t++) {
        sf_real *unit = w->unit + t * C * K, *fz = unit, *hx = unit + K, *hy = unit + 2 * K;
        for (int i = 0; i < K; i++) {
            sf_real fx = C == 6 ? unit[3 * K + i] : 0, fy = C == 6 ? unit[4 * K + i] : 0;
            hx[i] -= point[1] * fz[i] - point[2] * fy;
            hy[i] -= point[2] * fx - point[0] * fz[i];
            if (C == 6) unit[5 * K + i] -= point[0] * fy - point[1] * fx;
        }
        for (int r = 0; r < C; r++) {
            sf_real own[SF_CHANNELS];
            for (int i = 0; i < K; i++) mean[r * K + i] += unit[r * K + i] * (samples[t * wide + sf_at_dt(c)] / T);
            if (!spare) continue;
            sf_copy(own, unit + r * K, K);
            memset(unit + r * K, 0, (size_t)K * sizeof(sf_real));
            for (int i = 0; i < K; i++) sf_add(unit + r * K, own[i], spare + i * K, K);
        }
    }
}

/* Model._measure: the stated variance of what was measured, by the mean arm from o. */
SF_API void sf_measured_variance(const sf_config *c, const sf_moment_config *m, const sf_real arm[3],
                                 sf_moment_rows *out) {
    int C = m->components;
    const sf_real *v = m->velocity_variance;
    sf_real turned[9] = {0, -arm[2], arm[1], arm[2], 0, -arm[0], -arm[1], arm[0], 0}, noise[36];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            sf_real spread = i == k ? m->spin_variance : 0;
            for (int l = 0; l < 3; l++) spread += turned[3 * i + l] * v[l] * turned[3 * k + l];
            noise[6 * i + k] = i == k ? v[i] : 0;
            noise[6 * (3 + i) + k] = noise[6 * k + 3 + i] = turned[3 * i + k] * v[k];
            noise[6 * (3 + i) + 3 + k] = spread;
        }
    for (int i = 0; i < C; i++)
        for (int k = 0; k < C; k++)
            out->variance[i * C + k] = noise[6 * sf_component(i) + sf_component(k)] / (c->gravity * c->gravity);
}

/* Model._tilt: level components of the mean normal of the loaded soles times the height of the centre of mass, in axes
   that head along (x, y). */
SF_API void sf_moment_tilt(const sf_config *c, const sf_moment_config *m, const sf_real *samples, int n,
                           const sf_real *spare, sf_real x, sf_real y, sf_moment_work *w) {
    int K = c->channels;
    sf_real normal[2] = {0, 0}, total = 0, *tilt = w->rows.tilt;
    for (int t = 0; t < n; t++)
        for (int foot = 0; foot < c->feet; foot++) {
            const sf_real *map = c->wrench_map + foot * 6 * K + 2 * K, *force = w->force + t * K;
            const sf_real *R = samples + t * sf_waiting(c) + sf_at_rotation(c) + 9 * foot;
            sf_real load = 0;
            for (int i = 0; i < K; i++)
                if (map[i] != 0) load += map[i] * (spare ? sf_dot(spare + i * K, force, K) : force[i]);
            load = sf_max(load, 0);
            total += load, normal[0] += load * R[2], normal[1] += load * R[5];
        }
    if (m->level < 0 || total < m->least_load * (sf_real)n) {
        tilt[0] = tilt[1] = (sf_real)NAN;
        return;
    }
    tilt[0] = w->rows.height * (normal[0] * x + normal[1] * y) / total;
    tilt[1] = w->rows.height * (normal[1] * x - normal[0] * y) / total;
}

/* Model.rows. published: scales, offsets and drift; lasting: variance of each channel's force that
   lasts, in W^2. */
SF_API void sf_moment_rows_of(const sf_config *c, const sf_moment_config *m, const sf_real *samples, int n,
                                const sf_real *published, const sf_real *lasting, const sf_real *spare,
                                sf_moment_work *w) {
    int K = c->channels, C = m->components, N = sf_states(c, m), wide = sf_waiting(c), at = sf_momenta(c, m);
    const sf_real *a = published, *b = published + K, *u = published + 2 * K;
    sf_moment_rows *out = &w->rows;
    sf_real read[SF_CHANNELS] = {0}, x = 0, y = 0, norm, arm[3] = {0, 0, 0}, fewest;
    sf_real weighted[SF_COMPONENTS * SF_CHANNELS] = {0}, pulls[2 * SF_COMPONENTS] = {0}, shares[2] = {0, 0}, after;
    sf_real pushes[2 * SF_COMPONENTS] = {0}, reach[2 * SF_COMPONENTS * SF_CHANNELS] = {0};
    for (int t = 0; t < n; t++)
        for (int i = 0; i < K; i++) {
            w->force[t * K + i] = a[i] * samples[t * wide + i] + b[i] + u[i];
            read[i] += samples[t * wide + K + i];
        }
    sf_units(c, m, samples, n, spare, weighted, w);
    sf_real T = out->duration;
    memset(out->mean, 0, (size_t)(C * N) * sizeof(sf_real));
    memset(out->end, 0, (size_t)(C * N) * sizeof(sf_real));
    memset(out->walk, 0, (size_t)(C * C) * sizeof(sf_real));
    memset(out->crossed, 0, (size_t)(C * K * K) * sizeof(sf_real));
    memset(out->measured, 0, (size_t)C * sizeof(sf_real));
    memset(out->velocity, 0, sizeof out->velocity);
    out->height = 0;
    fewest = (sf_real)n;
    for (int i = 0; i < K; i++)
        if (!spare || spare[i * K + i] > (sf_real)0.5) fewest = sf_min(fewest, read[i]);
    sf_real held = (sf_real)n / sf_max(fewest, 1); /* samples that a reading stands for on the average */
    after = T;
    for (int t = 0; t < n; t++) {
        const sf_real *row = samples + t * wide, *unit = w->unit + t * C * K, *force = w->force + t * K;
        const sf_real *end = row + sf_at_end(c), *com = row + sf_at_com(c), *velocity = row + sf_at_velocity(c);
        const sf_real *rotation = row + sf_at_rotation(c);
        sf_real dt = row[sf_at_dt(c)], share[2] = {dt * (after / T), dt};
        sf_real away[3], by[3], wrench[6], gravity[3] = {-1, -(com[1] - out->point[1]), com[0] - out->point[0]};
        for (int r = 0; r < C; r++) {
            sf_real pull = r < 3 ? gravity[r] : 0, *scale[2] = {out->mean + r * N, out->end + r * N};
            sf_real push = sf_dot(unit + r * K, force, K);
            for (int which = 0; which < 2; which++) {
                sf_real *far = reach + (which * C + r) * K, *first = scale[which], by_share = share[which];
                for (int i = 0; i < K; i++) {
                    sf_real one = by_share * unit[r * K + i];
                    first[i] += one * row[i];
                    far[i] += one;
                }
                for (int j = 0; j < m->talks; j++)
                    first[3 * K + j] += by_share * unit[r * K + m->talk_to[j]] * row[m->talk_from[j]];
                pushes[which * C + r] += by_share * push;
                pulls[which * C + r] += by_share * pull;
            }
            for (int i = 0; i < K; i++) {
                sf_add(out->crossed + (r * K + i) * K, share[0] * unit[r * K + i], row, K);
            }
        }
        for (int which = 0; which < 2; which++) shares[which] += share[which];
        /* Chips have clocks of their own: what a channel changes by is an error of its own. */
        for (int i = 0; t > 0 && i < K; i++) {
            sf_real change = (force[i] - force[i - K]) * (dt * m->ripple * held);
            for (int r = 0; r < C; r++)
                for (int k = 0; k <= r; k++)
                    out->walk[r * C + k] += unit[r * K + i] * change * (unit[k * K + i] * change);
        }
        for (int foot = 0; foot < c->feet; foot++) x += rotation[9 * foot], y += rotation[9 * foot + 3];
        for (int k = 0; k < 3; k++) {
            away[k] = end[k] - out->point[k];
            arm[k] += away[k] / (sf_real)n;
            out->velocity[k] += velocity[k] / (sf_real)n;
        }
        sf_cross(by, away, velocity);
        for (int k = 0; k < 3; k++) wrench[k] = velocity[k], wrench[3 + k] = row[sf_at_spin(c) + k] + by[k];
        for (int r = 0; r < C; r++) {
            out->at_end[r] = wrench[sf_component(r)] / c->gravity;
            out->measured[r] += dt * out->at_end[r] / T;
        }
        out->height += (com[2] - out->point[2]) / (sf_real)n;
        after -= dt;
    }
    norm = sf_sqrt(x * x + y * y);
    if (norm == 0) norm = 1;
    x /= norm, y /= norm;
    for (int which = 0; which < 2; which++) {
        sf_real *H = which ? out->end : out->mean, *rest = which ? out->end_rest : out->mean_rest, share = shares[which];
        for (int r = 0; r < C; r++) {
            sf_real *row = H + r * N, *far = reach + (which * C + r) * K;
            rest[r] = pulls[which * C + r];
            for (int i = 0; i < K; i++) {
                row[K + i] = row[2 * K + i] = far[i];
            }
            row[at - 2] = pushes[which * C + r];
            row[at + r] = 1;
            row[at + C + r] = share;
            if (!which) row[at - 1] -= (pushes[C + r] + pulls[C + r]) / T;
        }
        /* The weight's torque about o: of an error of the centre of mass, in axes that head as the feet do. */
        sf_real *hx = H + N, *hy = H + 2 * N;
        hx[sf_coms(c, m)] = share * y, hx[sf_coms(c, m) + 1] = share * x;
        hy[sf_coms(c, m)] = share * -x, hy[sf_coms(c, m) + 1] = share * y;
        hx[at - 1] -= share * out->velocity[1];
        hy[at - 1] += share * out->velocity[0];
    }
    for (int r = 0; r < C; r++) {
        for (int k = 0; k < r; k++) out->walk[k * C + r] = out->walk[r * C + k];
        out->lasting[r] = 0;
        for (int i = 0; i < K; i++) out->lasting[r] += weighted[r * K + i] * weighted[r * K + i] * lasting[i];
    }
    sf_measured_variance(c, m, arm, out);
    sf_moment_tilt(c, m, samples, n, spare, x, y, w);
}

/* Model.allow_for_tilt: let the centre of mass be as far off as the soles are tilted. */
SF_API void sf_allow_for_tilt(const sf_config *c, const sf_moment_config *m, const sf_moment_rows *rows, sf_tilt *s,
                              sf_modes *belief) {
    int N = sf_states(c, m), com = sf_coms(c, m);
    if (rows->tilt[0] != rows->tilt[0]) return;
    s->time = sf_min(s->time + rows->duration, m->tilt_memory);
    for (int k = 0; k < 2; k++) {
        sf_real known = belief->com_shift[k], square, possible;
        s->shift[k] += rows->duration / s->time * (rows->tilt[k] - s->shift[k]);
        square = sf_power2(s->shift[k]) - sf_power2(m->tilt_noise * rows->height);
        if (!(square > 0 && square > known * known)) continue;
        possible = s->shift[k] < 0 ? -sf_sqrt(square) : sf_sqrt(square);
        for (int j = 0; j < SF_MODES; j++) {
            belief->mean[j * N + com + k] += m->tilt_mean * (possible - known);
            belief->covariance[j * N * N + (com + k) * (N + 1)] += sf_power2(m->tilt_std) * (possible * possible - known * known);
        }
        belief->com_shift[k] = possible;
    }
}

/* Model.move of a momentum: go on to a point o that has moved by `step` in m, H <- H - step x P. */
SF_API void sf_move_momentum(const sf_config *c, const sf_moment_config *m, const sf_real step[3],
                             const sf_real *velocity, sf_real *p) {
    int shear = m->components == 6;
    p[1] += -step[1] * p[0] + step[2] * (shear ? p[4] : velocity[1] / c->gravity);
    p[2] += step[0] * p[0] - step[2] * (shear ? p[3] : velocity[0] / c->gravity);
    if (shear) p[5] += step[1] * p[3] - step[0] * p[4];
}

/* Model.move, and what it does to the modes: go on to a point o that has moved by `step` in m. */
SF_API void sf_moment_move(const sf_config *c, const sf_moment_config *m, const sf_real step[3],
                             const sf_real *velocity, sf_modes *s) {
    int C = m->components, N = sf_states(c, m), at = sf_momenta(c, m);
    struct {
        int to, from;
        sf_real by;
    } moves[6] = {{1, 0, -step[1]}, {2, 0, step[0]}, {1, 4, step[2]}, {2, 3, -step[2]}, {5, 4, -step[0]}, {5, 3, step[1]}};
    for (int j = 0; j < SF_MODES; j++) {
        sf_real *P = s->covariance + j * N * N;
        sf_move_momentum(c, m, step, velocity, s->mean + j * N + at);
        for (int k = 0; k < (C == 6 ? 6 : 2); k++) {
            int to = at + moves[k].to, from = at + moves[k].from;
            sf_add(P + to * N, moves[k].by, P + from * N, N);
            for (int i = 0; i < N; i++) P[i * N + to] += moves[k].by * P[i * N + from];
        }
    }
}

/* -------------------------------------------------------------------------------------------------- modes */

/* wrench_variance */
SF_API sf_real sf_wrench_variance(const sf_moment_config *m, const sf_moment_rows *rows, int mode, int row) {
    sf_real std = sf_is_force(row) ? m->mode_force[mode] : m->mode_torque[mode] * rows->height;
    return std * std + rows->lasting[row];
}

/* begin: let unknowns begin anew, at 0; their variances are left at 0 as well. */
SF_API void sf_begin(sf_real *mean, sf_real *P, int N, int first, int count) {
    for (int k = first; k < first + count; k++) {
        mean[k] = 0;
        for (int i = 0; i < N; i++) P[k * N + i] = P[i * N + k] = 0;
    }
}

/* The lower half of a symmetric matrix, into its upper half: two columns at once. */
SF_API void sf_mirror(sf_real *P, int N) {
    for (int i = 0; i < N; i += 2) {
        const sf_real *one = P + i * N, *two = i + 1 < N ? one + N : one;
        sf_real *to = P + i;
        for (int k = 0; k < i; k++, to += N) to[0] = one[k], to[two != one] = two[k];
        if (two != one) to[1] = two[i];
    }
}

/* n, rounded up to a multiple of 8, but at most `most`. */
SF_API int sf_rounded(int n, int most) {
    int up = (n + 7) / 8 * 8;
    return up < most ? up : most;
}

/* mix: let modes turn into each other. */
SF_API void sf_mix(const sf_config *c, const sf_moment_config *m, const sf_modes *s, const sf_moment_rows *rows,
                   sf_modes *out) {
    int C = m->components, N = sf_states(c, m), wrench = sf_momenta(c, m) + C;
    sf_real turning[SF_MODES][SF_MODES];
    sf_copy(out->com_shift, s->com_shift, 2);
    for (int i = 0; i < SF_MODES; i++) {
        sf_real leaves = 0;
        for (int j = 0; j < SF_MODES; j++) leaves += turning[i][j] = m->rates[i * SF_MODES + j] * rows->duration;
        turning[i][i] += 1 - leaves;
    }
    for (int j = 0; j < SF_MODES; j++) {
        sf_real share[SF_MODES], *mean = out->mean + j * N, *P = out->covariance + j * N * N, chance = 0;
        sf_real away[SF_MODES][SF_STATES];
        for (int i = 0; i < SF_MODES; i++) chance += turning[i][j] * s->chance[i];
        out->chance[j] = chance;
        memset(mean, 0, (size_t)N * sizeof(sf_real));
        for (int i = 0; i < SF_MODES; i++) {
            share[i] = turning[i][j] * s->chance[i] / chance;
            sf_copy(away[i], s->mean + i * N, N);
            if (i != j) memset(away[i] + wrench, 0, (size_t)C * sizeof(sf_real));
            sf_add(mean, share[i], away[i], N);
        }
        for (int i = 0; i < SF_MODES; i++)
            for (int k = 0; k < N; k++) away[i][k] -= mean[k];
        for (int r = 0; r < N; r++) {
            sf_real *row = P + r * N, by[SF_MODES], own[SF_MODES];
            for (int i = 0; i < SF_MODES; i++) {
                own[i] = r >= wrench && i != j ? 0 : share[i]; /* the wrench of another mode starts again */
                by[i] = share[i] * away[i][r];
            }
            const sf_real *p = s->covariance + r * N, *q = p + N * N, *o = q + N * N;
            for (int k = 0; k <= r; k++)
                row[k] = own[0] * p[k] + own[1] * q[k] + own[2] * o[k] + by[0] * away[0][k] + by[1] * away[1][k] +
                         by[2] * away[2][k];
        }
        for (int i = 0; i < SF_MODES; i++) {
            if (i == j) continue;
            for (int r = 0; r < C; r++)
                P[(wrench + r) * N + wrench + r] += share[i] * sf_wrench_variance(m, rows, j, r);
        }
        sf_mirror(P, N);
    }
}

/* update: take in rows, of which `predicted` is H P. `first` to `last`: unknowns that are considered and not estimated.
   S: what the innovation is expected to be; of this, U' U, the innovation squared, x' S^-1 x, and the logarithm of the
   determinant, NaN where it is not positive definite. */
SF_API int sf_moment_update(sf_real *mean, sf_real *P, int N, int rows, const sf_real *predicted, const sf_real *innovation,
                              const sf_real *S, int first, int last, sf_real *room, sf_real *square, sf_real *size) {
    int wide = rows + N + 1;
    const sf_real *W = room + rows; /* U'^-1 H P, and behind it U'^-1 of the innovation */
    sf_real product = 1;
    *square = 0, *size = (sf_real)NAN;
    for (int r = 0; r < rows; r++) {
        sf_copy(room + r * wide, S + r * rows, rows);
        sf_copy(room + r * wide + rows, predicted + r * N, N);
        room[r * wide + rows + N] = innovation[r];
    }
    if (!sf_cholesky(room, rows, wide)) return 0;
    for (int r = 0; r < rows; r++) {
        const sf_real *row = W + r * wide;
        sf_add(mean, row[N], row, first);
        sf_add(mean + last, row[N], row + last, N - last);
        *square += row[N] * row[N], product *= room[r * wide + r];
    }
    *size = 2 * sf_log(product);
    /* What is considered keeps its own covariance. */
    for (int i = first > 0 ? 0 : last; i < N; i++)
        sf_add_rows(P + i * N, -1, W + i, wide, W, wide, rows, i >= first && i < last ? first : sf_rounded(i + 1, N));
    sf_mirror(P, N);
    return 1;
}

/* What a block taught: Step, but for the modes themselves. */
typedef struct {
    sf_real likelihood[SF_MODES], nis;
} sf_taught;

/* learn: predict the block's mean momentum in each mode, measure it, and go on to the block's end. */
SF_API int sf_moment_learn(const sf_config *c, const sf_moment_config *m, sf_modes *s, sf_moment_work *w, sf_taught *out) {
    int C = m->components, N = sf_states(c, m), at = sf_momenta(c, m), wrench = at + C, likeliest = 0, good = 1;
    const sf_moment_rows *rows = &w->rows;
    out->nis = 0;
    for (int j = 1; j < SF_MODES; j++)
        if (s->chance[j] > s->chance[likeliest]) likeliest = j;
    for (int j = 0; j < SF_MODES; j++) {
        sf_real *mean = s->mean + j * N, *P = s->covariance + j * N * N, *predicted = w->A, *end = w->B;
        sf_real decay = sf_exp(-rows->duration / m->mode_time[j]), innovation[SF_COMPONENTS], square, size;
        sf_real expected[SF_COMPONENTS * SF_COMPONENTS], moved[SF_COMPONENTS];
        for (int k = wrench; k < N; k++) {
            mean[k] *= decay;
            for (int i = 0; i < N; i++) P[k * N + i] *= decay;
            for (int i = 0; i < N; i++) P[i * N + k] *= decay;
            P[k * N + k] += sf_wrench_variance(m, rows, j, k - wrench) * (1 - decay * decay);
        }
        sf_multiply(predicted, rows->mean, P, C, N, N);
        for (int r = 0; r < C; r++) {
            innovation[r] = rows->measured[r] - sf_dot(rows->mean + r * N, mean, N) - rows->mean_rest[r];
            /* The mean over a block of what walks within it has a third of its variance at the end. */
            for (int k = 0; k < C; k++)
                expected[r * C + k] = sf_dot(predicted + r * N, rows->mean + k * N, N) +
                                      (rows->variance[r * C + k] + rows->walk[r * C + k] / 3);
        }
        /* The mass is considered and not estimated. While somebody holds the robot, that holds for everything but its
           momentum. */
        int first = j == m->held ? 0 : at - 2, last = j == m->held ? at : at - 1;
        good = sf_moment_update(mean, P, N, C, predicted, innovation, expected, first, last, w->B, &square, &size) && good;
        out->likelihood[j] = (sf_real)-0.5 * (square + size);
        if (j == likeliest) out->nis = square;
        sf_multiply(end, rows->end, P, C, N, N);
        for (int r = 0; r < C; r++) moved[r] = sf_dot(rows->end + r * N, mean, N) + rows->end_rest[r];
        sf_copy(mean + at, moved, C);
        for (int r = 0; r < C; r++) {
            sf_real *row = P + (at + r) * N;
            sf_copy(row, end + r * N, N);
            for (int k = 0; k < C; k++)
                row[at + k] = sf_dot(end + r * N, rows->end + k * N, N) + rows->walk[r * C + k];
        }
        for (int r = 0; r < C; r++)
            for (int i = 0; i < N; i++) P[i * N + at + r] = P[(at + r) * N + i];
    }
    return good;
}

/* support_probability: the probability that something other than the feet bears a part of the weight. */
SF_API sf_real sf_support_probability(const sf_config *c, const sf_moment_config *m, const sf_modes *s) {
    int N = sf_states(c, m), at = N - m->components;
    sf_real mean = s->mean[m->steady * N + at], variance = s->covariance[(m->steady * N + at) * N + at];
    return s->chance[m->held] + s->chance[m->steady] * (sf_real)(0.5 * erfc(-mean / sqrt(2.0 * variance)));
}

/* weigh_modes */
SF_API void sf_weigh_modes(const sf_moment_config *m, const sf_real *evidence, sf_real *chance) {
    sf_real most = evidence[0], total = 0, sum = 0;
    for (int j = 1; j < SF_MODES; j++) most = sf_max(most, evidence[j]);
    for (int j = 0; j < SF_MODES; j++) total += chance[j] *= sf_exp(evidence[j] - most);
    for (int j = 0; j < SF_MODES; j++) sum += chance[j] = sf_max(chance[j] / total, m->least_chance);
    for (int j = 0; j < SF_MODES; j++) chance[j] /= sum;
}

/* Whether a mode is likely enough to be handed out. */
SF_API int sf_published(const sf_moment_config *m, const sf_modes *s, int mode) {
    return s->chance[mode] >= m->least_published;
}

/* ----------------------------------------------------------------------------------------------- severity */

/* Severity.prior: standard deviations of the wide prior, and in these the variances with which others measure the start
   besides: of scales by the severity of scales, of offsets by theirs. */
SF_API void sf_priors(const sf_config *c, const sf_moment_config *m, sf_real drifted, sf_moment_work *w) {
    int K = c->channels, M = 2 * K;
    sf_real square = m->wide * m->wide, size[2][SF_SEVERITIES], stated[SF_JUDGED], wide[SF_JUDGED];
    for (int i = 0; i < K; i++) {
        stated[i] = m->spread_scale[i] + drifted, stated[K + i] = m->spread_offset[i];
        wide[i] = square * m->spread_scale[i] + drifted, wide[K + i] = square * m->spread_offset[i];
    }
    for (int i = 0; i < M; i++) w->std[i] = sf_sqrt(wide[i]), w->per_std[i] = 1 / w->std[i];
    for (int l = 0; l < SF_SEVERITIES; l++)
        for (int half = 0; half < 2; half++) {
            sf_real by = m->severities[l] * m->severities[l], product = 1;
            for (int i = half * K; i < (half + 1) * K; i++) {
                sf_real narrower = sf_max(wide[i] / (by * stated[i]) - 1, m->least_narrower);
                w->own[l * M + i] = 1 / narrower;
                product *= 1 + 1 / narrower;
            }
            size[half][l] = sf_log(product);
        }
    for (int i = 0; i < SF_SEVERITIES; i++)
        for (int l = 0; l < SF_SEVERITIES; l++)
            w->ahead[SF_SEVERITIES * i + l] = sf_log(m->likely[i] * m->likely[l]) + (sf_real)0.5 * (size[0][i] + size[1][l]);
}

/* Four matrices at once, as none of their numbers wait for another's: number k of all four is at 4 * k and behind; so many
   `lanes` of them are used. */

/* to += sign * sum of factor[k * apart] * B[k * wide ...] over `inner` rows, of n quadruples each. */
SF_API void sf_add_quads(sf_real *__restrict to, sf_real sign, const sf_real *factor, int apart, const sf_real *B,
                         int wide, int inner, int n, int lanes) {
    for (; n >= 4; n -= 4, to += 16, B += 16)
        for (int l = 0; l < lanes; l += SF_WIDE) {
            sf_wide a = *sf_at(to + l), b = *sf_at(to + 4 + l), c = *sf_at(to + 8 + l), d = *sf_at(to + 12 + l);
            for (int k = 0; k < inner; k++) {
                const sf_real *row = B + k * wide + l;
                sf_wide by = sign * *sf_from(factor + k * apart + l);
                a += by * *sf_from(row), b += by * *sf_from(row + 4);
                c += by * *sf_from(row + 8), d += by * *sf_from(row + 12);
            }
            *sf_at(to + l) = a, *sf_at(to + 4 + l) = b, *sf_at(to + 8 + l) = c, *sf_at(to + 12 + l) = d;
        }
    for (; n > 0; n--, to += 4, B += 4)
        for (int l = 0; l < lanes; l += SF_WIDE) {
            sf_wide a = *sf_at(to + l);
            for (int k = 0; k < inner; k++) a += sign * *sf_from(factor + k * apart + l) * *sf_from(B + k * wide + l);
            *sf_at(to + l) = a;
        }
}

/* Overwrite the upper halves of four A with U, A = U' U, and what stands behind them in rows of `wide` quadruples with
   U'^-1 of that. Diagonals are left as their inverses, of which `product` is that of all; NaN where U is none. */
SF_API void sf_factor_quads(sf_real *A, int n, int wide, int lanes, sf_real product[4]) {
    for (int l = 0; l < 4; l++) product[l] = 1;
    for (int i = 0; i < n; i++) {
        sf_real *row = A + 4 * (i * wide + i);
        sf_add_quads(row, -1, A + 4 * i, 4 * wide, A + 4 * i, 4 * wide, i, wide - i, lanes);
        for (int l = 0; l < lanes; l++) product[l] *= row[l] = 1 / sf_sqrt(row[l] > 0 ? row[l] : (sf_real)NAN);
        for (int k = 1; k < wide - i; k++)
            for (int l = 0; l < lanes; l += SF_WIDE) *sf_at(row + 4 * k + l) *= *sf_from(row + l);
    }
}

/* Four T = U'^-1 and G = (U' U)^-1 = T' T, shape (n, n), their lower halves, of U as sf_factor_quads leaves them. */
SF_API void sf_invert_quads(const sf_real *U, int n, int wide, int lanes, sf_real *T, sf_real *G) {
    memset(T, 0, (size_t)(4 * n * n) * sizeof(sf_real));
    memset(G, 0, (size_t)(4 * n * n) * sizeof(sf_real));
    for (int i = 0; i < n; i++) {
        sf_real *row = T + 4 * i * n;
        const sf_real *own = U + 4 * (i * wide + i);
        sf_add_quads(row, -1, U + 4 * i, 4 * wide, T, 4 * n, i, i, lanes);
        for (int k = 0; k < i; k++)
            for (int l = 0; l < lanes; l += SF_WIDE) *sf_at(row + 4 * k + l) *= *sf_from(own + l);
        sf_copy(row + 4 * i, own, 4);
    }
    for (int i = 0; i < n; i++)
        sf_add_quads(G + 4 * i * n, 1, T + 4 * (i * n + i), 4 * n, T + 4 * i * n, 4 * n, n - i, i + 1, lanes);
}

/* Severity._compare for one mode: hold all severities against the data, or those alone that have weight in `of`. What
   all severities of scales share is done once: with A, B and C of scales, both and offsets in P, U' U = C + E, W = U'^-1
   [B, off], and V' V = A - W' W + E of scales, y = V'^-1 of what is left of their means. Rows hold all of this. */
SF_API int sf_compare(const sf_config *c, const sf_real *mean, const sf_real *P, int N, const sf_compared *of,
                      sf_moment_work *w, sf_compared *d) {
    int K = c->channels, M = 2 * K, wide = K + 1, both = M + 1, place[4] = {0}, offsets[4], lanes = 0, count = 0;
    sf_real evidence[16], size[4], product[4], found[4] = {0, 0, 0, 0}, *U = d->U, *S = w->S, best = -HUGE_VAL, total = 0;
    for (int l = 0; l < 4; l++) {
        int before = count;
        for (int which = l; which < 16; which += 4)
            if (!of || of->weight[which] > 0) d->pair[count++] = which;
        if (count > before) place[l] = lanes, offsets[lanes++] = l;
    }
    for (int l = lanes; l < 4; l++) offsets[l] = offsets[0];
    lanes = (lanes + SF_WIDE - 1) / SF_WIDE * SF_WIDE;
    for (int i = 0; i < K; i++) {
        const sf_real *scale = P + i * N, *offset = P + (K + i) * N;
        for (int k = 0; k < K; k++)
            for (int l = 0; l < lanes; l++) {
                U[4 * (i * both + k) + l] = offset[K + k] * (w->per_std[K + i] * w->per_std[K + k]);
                U[4 * (i * both + K + k) + l] = offset[k] * (w->per_std[K + i] * w->per_std[k]);
                S[4 * (i * wide + k) + l] = scale[k] * (w->per_std[i] * w->per_std[k]);
            }
        for (int l = 0; l < lanes; l++) {
            U[4 * (i * both + i) + l] += w->own[offsets[l] * M + K + i];
            U[4 * (i * both + M) + l] = mean[K + i] * w->per_std[K + i];
            S[4 * (i * wide + K) + l] = (mean[i] - 1) * w->per_std[i];
        }
    }
    sf_factor_quads(U, K, both, lanes, size);
    for (int i = 0; i < K; i++) {
        sf_real *left = U + 4 * (K + i);
        sf_add_quads(S + 4 * (i * wide + i), -1, left, 4 * both, left, 4 * both, K, wide - i, lanes);
        for (int l = 0; l < lanes; l++) found[l] += sf_power2(U[4 * (i * both + M) + l]);
    }
    for (int group = 0; group < count; group += 4) {
        sf_real *V = d->V + group * K * wide;
        for (int p = 0; p < 4; p++) {
            int which = d->pair[group + p < count ? group + p : group];
            const sf_real *from = S + place[which % 4], *own = w->own + which / 4 * M;
            for (int i = 0; i < K; i++) {
                for (int k = i; k < wide; k++) V[4 * (i * wide + k) + p] = from[4 * (i * wide + k)];
                V[4 * (i * wide + i) + p] += own[i];
            }
        }
        sf_factor_quads(V, K, wide, 4, product);
        for (int p = 0; p < 4 && group + p < count; p++) {
            int which = d->pair[group + p], l = place[which % 4];
            sf_real square = found[l];
            for (int i = 0; i < K; i++) square += sf_power2(V[4 * (i * wide + K) + p]);
            evidence[which] = w->ahead[which] - (sf_real)0.5 * square + sf_log(size[l] * product[p]);
            if (evidence[which] > best) best = evidence[which]; /* not of NaN */
        }
    }
    if (!sf_finite(best)) return 0;
    for (int which = 0; which < 16; which++) d->weight[which] = 0;
    for (int n = 0; n < count; n++) {
        sf_real *weight = d->weight + d->pair[n], less = evidence[d->pair[n]] - best;
        if (less > SF_LITTLE) total += *weight = sf_exp(less);
    }
    for (int which = 0; which < 16; which++) d->weight[which] /= total;
    for (int l = 0; l < 4; l++) d->place[l] = place[l];
    d->count = count;
    d->evidence = best + sf_log(total);
    return 1;
}

/* What measuring the start does to one mode under all severities together: the mean of all (P + E)^-1 (x - x0), and R,
   with which the mixture's covariance is P - P R P. With F = (V' V)^-1 and X = U^-1 W that is of [F, -F X'; -X F,
   (C + E)^-1 + X F X'], less the covariance of what pulls. */
SF_API void sf_pull(const sf_config *c, const sf_compared *d, sf_moment_work *w, sf_real *pull, sf_real *R) {
    int K = c->channels, M = 2 * K, wide = K + 1, both = M + 1;
    sf_real *T = w->T, *G = w->G, *F = w->F, *X = w->X, *S = w->S, *found = w->found, sum[4] = {0, 0, 0, 0};
    memset(pull, 0, (size_t)M * sizeof(sf_real));
    memset(R, 0, (size_t)(M * M) * sizeof(sf_real));
    memset(F, 0, (size_t)(4 * K * K) * sizeof(sf_real));
    memset(S, 0, (size_t)(4 * K * wide) * sizeof(sf_real));
    sf_invert_quads(d->U, K, both, 4, T, G);
    for (int i = 0; i < K; i++)
        sf_add_quads(S + 4 * i * wide, 1, T + 4 * (i * K + i), 4 * K, d->U + 4 * (i * both + K), 4 * both, K - i, wide, 4);
    for (int n = 0; n < d->count; n++) sum[d->pair[n] % 4] += d->weight[d->pair[n]];
    for (int l = 0; l < 4; l++) {
        const sf_real *own = G + d->place[l];
        if (!(sum[l] > 0)) continue;
        for (int i = 0; i < K * wide; i++) X[l * K * wide + i] = S[4 * i + d->place[l]];
        for (int i = 0; i < K; i++)
            for (int k = 0; k <= i; k++) R[(K + i) * M + K + k] += sum[l] * own[4 * (i * K + k)];
    }
    for (int group = 0; group < d->count; group += 4) {
        const sf_real *V = d->V + group * K * wide;
        sf_real scale[4 * SF_CHANNELS] = {0}; /* V^-1 y */
        sf_invert_quads(V, K, wide, 4, T, G);
        for (int i = 0; i < K; i++)
            sf_add_quads(scale + 4 * i, 1, T + 4 * (i * K + i), 4 * K, V + 4 * (i * wide + K), 4 * wide, K - i, 1, 4);
        for (int p = 0; p < 4 && group + p < d->count; p++) {
            int which = d->pair[group + p];
            sf_real weight = d->weight[which], *own = found + which * M, *to = F + which % 4 * K * K;
            const sf_real *back = X + which % 4 * K * wide;
            if (!(weight > 0)) continue;
            for (int i = 0; i < K; i++) own[i] = scale[4 * i + p];
            for (int i = 0; i < K; i++) own[K + i] = back[i * wide + K] - sf_dot(back + i * wide, own, K);
            sf_add(pull, weight, own, M);
            for (int i = 0; i < K; i++)
                for (int k = 0; k <= i; k++) to[i * K + k] += weight * G[4 * (i * K + k) + p];
        }
    }
    for (int l = 0; l < 4; l++) {
        const sf_real *back = X + l * K * wide;
        sf_real *own = F + l * K * K;
        if (!(sum[l] > 0)) continue;
        sf_mirror(own, K);
        for (int i = 0; i < K; i++) {
            sf_real *row = R + (K + i) * M, turned[SF_CHANNELS] = {0};
            sf_add(R + i * M, 1, own + i * K, K);
            sf_add_rows(turned, 1, back + i * wide, 1, own, K, K, K);
            sf_add(row, -1, turned, K);
            for (int k = 0; k <= i; k++) row[K + k] += sf_dot(turned, back + k * wide, K);
        }
    }
    for (int which = 0; which < 16; which++) {
        sf_real *own = found + which * M;
        if (!(d->weight[which] > 0)) continue;
        for (int i = 0; i < M; i++) own[i] -= pull[i];
        for (int i = 0; i < M; i++) sf_add(R + i * M, -d->weight[which] * own[i], own, i + 1);
    }
    sf_mirror(R, M);
}

/* Severity.weigh, its end, and Weighed.publish: what all modes hold together. */
SF_API void sf_moment_publish(const sf_config *c, const sf_moment_config *m, const sf_modes *belief, sf_moment_work *w,
                              sf_publication *out) {
    int K = c->channels, J = 2 * K, M = sf_weighed(c), N = sf_states(c, m);
    sf_real means[SF_MODES * SF_WEIGHED], chance[SF_MODES], pull[SF_JUDGED], *with = w->A, *turned = w->B, all = 0;
    for (int j = 0; j < SF_MODES; j++) all += chance[j] = sf_published(m, belief, j) ? belief->chance[j] : 0;
    memset(out->mean, 0, (size_t)M * sizeof(sf_real));
    memset(out->covariance, 0, (size_t)(M * M) * sizeof(sf_real));
    memset(out->undetermined, 0, (size_t)K * sizeof(sf_real));
    for (int j = 0; j < SF_MODES; j++) {
        const sf_compared *d = &w->compared[j];
        const sf_real *P = belief->covariance + j * N * N;
        sf_real *mean = means + j * M;
        if (!(chance[j] > 0)) continue;
        chance[j] /= all;
        sf_pull(c, d, w, pull, w->R);
        for (int i = 0; i < J; i++)
            for (int k = 0; k < M; k++) with[i * M + k] = w->per_std[i] * P[i * N + k];
        sf_multiply(turned, w->R, with, J, J, M);
        sf_copy(mean, belief->mean + j * N, M);
        sf_add_rows(mean, -1, pull, 1, with, M, J, M);
        for (int i = 0; i < M; i++) {
            sf_real row[SF_WEIGHED];
            sf_copy(row, P + i * N, M);
            sf_add_rows(row, -1, turned + i, M, with, M, J, sf_rounded(i + 1, M));
            sf_add(out->covariance + i * M, chance[j], row, i + 1);
            if (i >= K) continue;
            sf_real prior = 0;
            for (int which = 0; which < 16; which++) {
                sf_real own = w->own[which / 4 * J + i];
                prior += d->weight[which] * (own / (1 + own));
            }
            out->undetermined[i] += chance[j] * (row[i] / (prior * w->std[i] * w->std[i]));
        }
        sf_add(out->mean, chance[j], mean, M);
    }
    for (int j = 0; j < SF_MODES; j++) {
        sf_real *apart = means + j * M;
        if (!(chance[j] > 0)) continue;
        for (int i = 0; i < M; i++) apart[i] -= out->mean[i];
        for (int i = 0; i < M; i++) sf_add(out->covariance + i * M, chance[j] * apart[i], apart, i + 1);
    }
    for (int i = 0; i < K; i++) out->undetermined[i] = sf_clip(out->undetermined[i], 0, 1);
    sf_mirror(out->covariance, M);
}

/* ----------------------------------------------------------------------------------------- health, report */

/* map_covariance: the covariance of (a, b) of each channel, b in N, shape (2K, 2K). */
SF_API void sf_map_covariance(const sf_config *c, const sf_moment_config *m, const sf_publication *p, sf_real rate,
                              sf_real *learnt) {
    int K = c->channels, M = sf_weighed(c), wide = 2 * K;
    sf_real W = c->weight, row[SF_WEIGHED], time = rate * rate * m->ahead;
    for (int r = 0; r < wide; r++) {
        int i = r % K;
        if (r < K) sf_copy(row, p->covariance + i * M, 3 * K);
        else
            for (int k = 0; k < 3 * K; k++)
                row[k] = W * (p->covariance[(K + i) * M + k] + p->covariance[(2 * K + i) * M + k]);
        for (int k = 0; k < K; k++) {
            learnt[r * wide + k] = row[k];
            learnt[r * wide + K + k] = W * (row[K + k] + row[2 * K + k]);
        }
        for (int k = 0; k < r; k++)
            learnt[r * wide + k] = learnt[k * wide + r] = (sf_real)0.5 * (learnt[r * wide + k] + learnt[k * wide + r]);
    }
    /* drift_on: until the map is applied. */
    for (int i = 0; i < K; i++) {
        learnt[i * wide + i] += m->walk[i] * time;
        learnt[(K + i) * wide + K + i] += m->walk[K + i] * time * sf_power2(p->mean[i] * W);
    }
}

/* Three products r S q' of rows over (a, b): of one, of both, of the other. Most numbers of a row are zeros. */
SF_API void sf_products(const sf_config *c, const sf_real *S, const sf_real *one, const sf_real *other, sf_real out[3]) {
    int wide = 2 * c->channels;
    sf_real p[2 * SF_CHANNELS] = {0}, q[2 * SF_CHANNELS] = {0};
    sf_add_rows(p, 1, one, 1, S, wide, wide, wide);
    out[0] = sf_dot(p, one, wide);
    if (one == other) return;
    sf_add_rows(q, 1, other, 1, S, wide, wide, wide);
    out[1] = sf_dot(p, other, wide), out[2] = sf_dot(q, other, wide);
}

/* contact_probability of one foot: its load in N, and the variance of that. */
SF_API sf_real sf_contact(const sf_config *c, const sf_moment_config *m, sf_real load, sf_real variance) {
    sf_real std = sf_sqrt(variance), most = m->most_load * c->weight, far = sf_min(load / std, 30);
    sf_real with_load = (sf_real)(0.5 * erfc(-load / std / sqrt(2.0))) / most;
    sf_real without = sf_exp((sf_real)-0.5 * far * far) / (sf_sqrt((sf_real)(2 * 3.141592653589793)) * std);
    /* A pull of no sole counts as no load. */
    if (load <= 0) without = sf_max(without, 1 / most);
    return with_load / (with_load + without);
}

/* MomentFilter._line: a, and b in N, as they are handed out. */
SF_API void sf_line(const sf_config *c, const sf_publication *p, sf_real *a, sf_real *b) {
    int K = c->channels;
    for (int i = 0; i < K; i++) {
        a[i] = p->mean[i];
        b[i] = (p->mean[K + i] + p->mean[2 * K + i]) * c->weight;
    }
}

/* MomentFilter._estimate: apply the map to the newest sample, and say how sure it is. */
SF_API void sf_moment_estimate(const sf_config *c, const sf_moment_config *m, const sf_moment_state *s,
                                 const sf_sample *sample, sf_estimate *out) {
    int K = c->channels, wide = 2 * K, worse = s->versus_start.evidence > m->versus_sure ? SF_WORSE_THAN_START : 0;
    const sf_real *F0 = sample->force, *S = s->covariance;
    const sf_channel_faults *faults = &s->faults;
    sf_real a[SF_CHANNELS], b[SF_CHANNELS], force[SF_CHANNELS], moved[SF_CHANNELS], change[SF_CHANNELS];
    sf_real aligned[SF_CHANNELS];
    sf_real rows[3 * SF_CHANNELS], turned[2][2 * SF_CHANNELS], found[3];
    sf_level_rows(c, s->front.motion, rows);
    sf_line(c, &s->published, a, b);
    for (int i = 0; i < K; i++) {
        force[i] = a[i] * F0[i] + b[i];
        moved[i] = a[i] * sample->change[i];
        aligned[i] = a[i] * sample->aligned[i] + b[i];
        out->scale[i] = a[i] * c->scale[i];
        out->offset[i] = a[i] * (c->offset[i] - s->shift[i]) + b[i];
        out->flags[i] = sample->flags[i] | s->status | worse;
    }
    for (int i = 0; i < K; i++) {
        out->force[i] = faults->altered ? sf_dot(faults->spare + i * K, force, K) : force[i];
        change[i] = faults->altered ? sf_dot(faults->spare + i * K, moved, K) : moved[i];
        out->force_aligned[i] = faults->altered ? sf_dot(faults->spare + i * K, aligned, K) : aligned[i];
    }
    sf_real load = sf_report_now(c, &s->front, rows, change, out);
    if (!out->cop_valid) load = 1;

    for (int i = 0; i < K; i++) {
        sf_real variance = (F0[i] * S[i * wide + i] + 2 * S[(K + i) * wide + i]) * F0[i] + S[(K + i) * wide + K + i];
        if (faults->altered) {
            const sf_real *spare = faults->spare + i * K;
            for (int k = 0; k < K; k++) turned[0][k] = spare[k] * F0[k], turned[0][K + k] = spare[k];
            sf_products(c, S, turned[0], turned[0], found);
            variance = found[0] + faults->spare_std[i] * faults->spare_std[i];
        }
        out->force_std[i] = sf_sqrt(sf_max(variance, 0));
    }
    for (int axis = 0; axis < 2; axis++) {
        sf_real one[SF_CHANNELS], own[SF_CHANNELS];
        for (int i = 0; i < K; i++) one[i] = (rows[(1 + axis) * K + i] - out->cop[axis] * rows[i]) / load;
        if (faults->altered) sf_multiply(own, one, faults->spare, 1, K, K);
        for (int i = 0; i < K; i++) {
            turned[axis][K + i] = faults->altered ? own[i] : one[i];
            turned[axis][i] = turned[axis][K + i] * F0[i];
        }
    }
    sf_products(c, S, turned[0], turned[1], found);
    for (int i = 0; i < 4; i++) out->cop_covariance[i] = found[(i + 1) / 2];
    for (int foot = 0; foot < c->feet; foot++) {
        sf_real square = 0;
        for (int i = 0; i < K; i++) {
            sf_real up = c->foot_of_channel[i] == foot ? rows[i] : 0;
            turned[0][i] = up * F0[i], turned[0][K + i] = up;
            square += up * up;
        }
        sf_products(c, S, turned[0], turned[0], found);
        sf_real noise = sf_max(square, m->least_row) * m->reading_noise * m->reading_noise;
        out->contact_probability[foot] = sf_contact(c, m, out->vgrf[foot], sf_max(found[0], 0) + noise);
    }
    sf_copy(out->undetermined, s->published.undetermined, K);
}

/* --------------------------------------------------------------------------------------------------- tare */

/* Swing */
typedef struct {
    sf_real reading[SF_CHANNELS], seconds, rough;
} sf_swing;

/* Tare._read: the readings of a foot in swing, of the channels that are not lost. */
SF_API void sf_read_swing(const sf_config *c, const sf_moment_config *m, const sf_moment_state *s, int n, int foot,
                          const int *channels, int count, sf_swing *out) {
    int K = c->channels, wide = sf_waiting(c), at = sf_at_swing(c) + foot, found = 0, sure[SF_BLOCK];
    memset(out, 0, sizeof *out);
    for (int t = 0; t < n; t++) {
        const sf_real *row = s->pending + t * wide, *before = t ? row - wide : s->before, *behind = t + 1 < n ? row + wide : row;
        /* The sample before and the one after are in the air as well. */
        sure[t] = row[at] > (sf_real)0.5 && before[at] > (sf_real)0.5 && behind[at] > (sf_real)0.5;
        for (int k = 0; k < count; k++) sure[t] = sure[t] && row[K + channels[k]] > (sf_real)0.5;
        if (!sure[t]) continue;
        found++;
        out->seconds += row[sf_at_dt(c)];
        for (int k = 0; k < count; k++) out->reading[k] += row[channels[k]];
    }
    for (int k = 0; k < count && found; k++) out->reading[k] /= (sf_real)found;
    for (int t = 0; t < n; t++)
        for (int k = 0; k < count && sure[t]; k++)
            out->rough += sf_power2(s->pending[t * wide + channels[k]] - out->reading[k]) / m->tare_variance[channels[k]];
    if (found && count) out->rough *= out->seconds / (sf_real)(found * (found > 1 ? found - 1 : 1) * count);
    out->rough = sf_max(out->rough, 1);
}

/* _log_density of changes, with variances of their own and `more` of each channel's offset. */
SF_API sf_real sf_log_density(const sf_moment_config *m, const int *channels, int count, const sf_real *change,
                              const sf_real *variance, sf_real more) {
    sf_real sum = 0;
    for (int k = 0; k < count; k++) {
        sf_real spread = variance[k] + more * m->spread_offset[channels[k]];
        sum += change[k] * change[k] / spread + sf_log((sf_real)(2 * 3.141592653589793) * spread);
    }
    return (sf_real)-0.5 * sum;
}

/* Odds */
typedef struct {
    sf_real same, other, right;
} sf_odds;

/* Tare._weigh: what a foot in swing shows, by changes of its readings since the last tare and since the last swing that
   was taken for a load, with a variance. */
SF_API void sf_weigh_swing(const sf_config *c, const sf_moment_config *m, const sf_tares *tare, int foot, const int *channels,
                           int count, const sf_real *change, const sf_real *repeated, const sf_real *walked, sf_real rough,
                           sf_odds *out) {
    sf_real smooth = tare->rough[foot], over = rough / smooth, loaded = m->rough_density, fresh = 0, vertical = 0;
    sf_real sure = tare->sure[foot] * (1 - m->zero_jump), offer = tare->offer[foot];
    sf_real flat = (sf_real)-0.5 * ((sf_real)count * (over - 1 - sf_log(over)) + sf_power2(sf_log(smooth) / m->noise_spread));
    for (int i = 0; i < SF_SEVERITIES; i++)
        fresh += m->likely[i] * sf_exp(flat + sf_log_density(m, channels, count, change, walked, sf_power2(m->severities[i])));
    for (int k = 0; k < count; k++) {
        loaded /= sf_sqrt(m->loaded[channels[k]]);
        vertical += change[k] * c->wrench_map[(foot * 6 + 2) * c->channels + channels[k]];
    }
    sf_real same = sure * sf_exp(flat + sf_log_density(m, channels, count, change, walked, 0));
    sf_real other = offer * sf_exp(flat + sf_log_density(m, channels, count, repeated, walked, 0));
    other += sf_max(1 - sure - offer, 0) * fresh;
    sf_real right = same + (vertical > 0 ? loaded * sure : 0), total = right + other + loaded * (1 - sure); /* no load is negative */
    out->same = same / total, out->other = other / total, out->right = right / total;
}

/* Tare._learn_rate: by how many times sensors drift faster than stated. */
SF_API sf_real sf_followed_rate(const sf_moment_config *m, const sf_tares *s, const sf_real *change,
                                const sf_real *expected, int count) {
    sf_real mean = 0, surprise = 0, share = sf_max(m->rate_share, 1 / ((sf_real)s->followed + m->stated_rate));
    for (int k = 0; k < count; k++) mean += change[k] / (sf_real)count;
    for (int k = 0; k < count; k++) {
        sf_real own = (change[k] - mean) * (change[k] - mean) * (sf_real)count / (sf_real)(count > 1 ? count - 1 : 1);
        surprise += sf_min(own / expected[k], m->tare_surprise) / (sf_real)count;
    }
    return sf_clip(s->rate * sf_sqrt(1 + share * (surprise - 1)), m->smallest_rate, m->largest_rate);
}

/* Tare._learn: let all modes know forces of readings, `asked` with a variance, of some channels; returns whether they
   all could. */
SF_API int sf_learn_tare(const sf_config *c, const sf_moment_config *m, sf_modes *belief, const int *channels, int count,
                         const sf_real *reading, const sf_real *asked, const sf_real *variance, sf_moment_work *w) {
    int K = c->channels, N = sf_states(c, m), good = 1, mass = sf_momenta(c, m) - 2;
    sf_real innovation[SF_CHANNELS], S[SF_CHANNELS * SF_CHANNELS], *predicted = w->A, square, size;
    for (int j = 0; count && j < SF_MODES; j++) {
        sf_real *mean = belief->mean + j * N, *P = belief->covariance + j * N * N;
        memset(predicted, 0, (size_t)(count * N) * sizeof(sf_real));
        for (int k = 0; k < count; k++) {
            int i = channels[k];
            sf_real *row = predicted + k * N;
            sf_add(row, reading[k], P + i * N, N);
            sf_add(row, 1, P + (K + i) * N, N);
            sf_add(row, 1, P + (2 * K + i) * N, N);
            innovation[k] = asked[k] - (reading[k] * mean[i] + mean[K + i] + mean[2 * K + i]);
        }
        for (int k = 0; k < count; k++)
            for (int l = 0; l < count; l++) {
                int i = channels[l];
                const sf_real *row = predicted + k * N;
                S[k * count + l] = row[i] * reading[l] + row[K + i] + row[2 * K + i];
                if (k == l) S[k * count + l] += variance[k];
            }
        good = sf_moment_update(mean, P, N, count, predicted, innovation, S, mass, mass + 1, w->B, &square, &size) && good;
    }
    return good;
}

/* Tare._redefine: define the drift again by readings without load. */
SF_API void sf_redefine_drift(const sf_config *c, const sf_moment_config *m, sf_modes *belief, const int *channels,
                              int count, const sf_real *reading, const sf_real *variance) {
    int K = c->channels, N = sf_states(c, m);
    for (int j = 0; j < SF_MODES; j++) {
        sf_real *mean = belief->mean + j * N, *P = belief->covariance + j * N * N;
        for (int k = 0; k < count; k++) {
            int i = channels[k], drift = 2 * K + i;
            mean[drift] = -(reading[k] * mean[i] + mean[K + i]);
            for (int l = 0; l < N; l++) P[drift * N + l] = -(reading[k] * P[i * N + l] + P[(K + i) * N + l]);
            for (int l = 0; l < N; l++) P[l * N + drift] = -(reading[k] * P[l * N + i] + P[l * N + K + i]);
            P[drift * N + drift] += variance[k];
        }
    }
}

/* Tare.take: tare the feet that hang in a block. Changes the belief, what is published of drift, and the tares. Returns
   whether all modes could learn; `wrong` is set if a zero in use turned out to be that of a loaded foot. */
SF_API int sf_take_tare(const sf_config *c, const sf_moment_config *m, const sf_moment_state *s, int n, sf_real duration,
                        sf_modes *belief, sf_real *published, sf_tares *tare, sf_moment_work *w, int *wrong) {
    int K = c->channels, good = 1;
    for (int foot = 0; foot < c->feet; foot++) {
        int channels[SF_CHANNELS], steady[SF_CHANNELS], count = 0, few = 0, first = tare->time[foot] < 0;
        sf_real change[SF_CHANNELS], repeated[SF_CHANNELS], walked[SF_CHANNELS], variance[SF_CHANNELS], vertical = 0;
        sf_real before[SF_CHANNELS], asked[SF_CHANNELS], unsure[SF_CHANNELS], since = s->time - sf_max(tare->time[foot], 0);
        sf_swing swing;
        sf_odds odds;
        for (int i = 0; i < K; i++)
            if (c->foot_of_channel[i] == foot && s->faults.lost[i] < (sf_real)0.5) channels[count++] = i;
        sf_read_swing(c, m, s, n, foot, channels, count, &swing);
        if (!count || !(swing.seconds >= m->tare_share * duration)) continue;
        sf_real smooth = tare->rough[foot] = sf_max(sf_min(tare->rough[foot], swing.rough), 1);
        for (int k = 0; k < count; k++) {
            int i = channels[k];
            change[k] = swing.reading[k] - tare->reading[i];
            repeated[k] = swing.reading[k] - tare->offered[i];
            walked[k] = 2 * smooth * m->tare_variance[i] / swing.seconds + tare->rate * tare->rate * m->walk[K + i] * since;
            vertical += change[k] * c->wrench_map[(foot * 6 + 2) * K + i];
        }
        sf_weigh_swing(c, m, tare, foot, channels, count, change, repeated, walked, swing.rough, &odds);
        if (odds.same + odds.other < (sf_real)0.5) {
            tare->sure[foot] = odds.right, tare->offer[foot] = odds.other;
            for (int k = 0; k < count; k++) tare->offered[channels[k]] = swing.reading[k];
            continue;
        }
        int again = !first && since > m->least_apart, replaced = odds.other > odds.same;
        if (replaced && !first && vertical < 0 && tare->sure[foot] <= m->unconfirmed) *wrong = 1;
        for (int k = 0; k < count; k++) {
            int i = channels[k];
            sf_real shown = first ? swing.reading[k] : tare->reading[i] + tare->moved[i];
            sf_real noise = smooth * m->tare_variance[i] / swing.seconds + (1 - odds.same - odds.other) * m->loaded[i];
            variance[k] = published[i] * published[i] * noise;
            /* The drift of a zero that jumped is unknown. */
            if (!first && change[k] * change[k] > m->tare_leap * m->tare_leap * walked[k]) continue;
            steady[few] = i, before[few] = shown, asked[few] = -published[i] * (swing.reading[k] - shown);
            unsure[few++] = variance[k];
        }
        if (again) {
            tare->rate = sf_followed_rate(m, tare, change, walked, count);
            tare->followed++;
        }
        good = sf_learn_tare(c, m, belief, steady, few, before, asked, unsure, w) && good;
        if (!first) sf_redefine_drift(c, m, belief, channels, count, swing.reading, variance);
        for (int k = 0; k < count; k++) {
            int i = channels[k];
            published[2 * K + i] = -published[i] * swing.reading[k] - published[K + i];
            tare->reading[i] = swing.reading[k], tare->moved[i] = 0;
        }
        tare->time[foot] = s->time, tare->offer[foot] = 0;
        if (replaced) tare->sure[foot] = sf_min(odds.other, m->unconfirmed);
        else if (again) tare->sure[foot] = odds.same;
    }
    return good;
}

/* ------------------------------------------------------------------------------------------------- still */

/* still._likelihood: how likely drift alone is, against any larger change, by the sum over some channels of squares of
   changes by their variances. */
SF_API sf_real sf_still_likelihood(sf_real sum, int count) {
    sf_real larger = count ? sf_max(sum / (sf_real)count, 1) : 1;
    return count && isfinite(larger) ? sf_exp((sf_real)-0.5 * (sf_real)count * (larger - 1 - sf_log(larger))) : 0;
}

/* Still.take and _hold: let readings of a robot that stands still change without a word of scales. Changes the belief, the
   readings of late, and by how much those of tares have moved. */
SF_API void sf_take_still(const sf_config *c, const sf_moment_config *m, const sf_moment_state *s, int n,
                          sf_real duration, sf_modes *belief, const sf_real *published, sf_still *still, sf_tares *tare) {
    int K = c->channels, N = sf_states(c, m), wide = sf_waiting(c), count = 0;
    sf_real last = still->time, apart = s->time - last, rate = tare->rate * tare->rate, d = 0, off = 0;
    sf_real change[SF_CHANNELS], share = sf_min(apart / m->level_time, 1), likely;
    still->time = s->time;
    for (int i = 0; i < K; i++) {
        sf_real reading = 0, drift = rate * m->walk[K + i], noise = m->tare_variance[i] / duration;
        for (int t = 0; t < n; t++) reading += s->pending[t * wide + i] / (sf_real)n;
        change[i] = reading - still->reading[i];
        still->reading[i] = reading;
        still->level[i] = last < 0 ? reading : still->level[i] + share * (reading - still->level[i]);
        if (s->faults.lost[i] > (sf_real)0.5) continue;
        d += sf_power2(change[i]) / (drift * apart + 2 * noise);
        off += sf_power2(reading - still->level[i]) / ((sf_real)0.5 * drift * m->level_time + noise);
        count++;
    }
    if (last < 0) return;
    likely = sf_min(sf_still_likelihood(d, count), sf_still_likelihood(off, count));
    if (likely < m->least_still) return;
    for (int i = 0; i < K; i++) {
        if (s->faults.lost[i] > (sf_real)0.5) continue;
        sf_real drift = rate * m->walk[K + i] * m->level_time;
        sf_real moved = likely * drift / (drift + m->tare_variance[i] / duration) * change[i];
        for (int j = 0; j < SF_MODES; j++) {
            sf_real *P = belief->covariance + j * N * N, *mean = belief->mean + j * N;
            int at = 2 * K + i;
            mean[at] -= moved * (mean[i] - published[i]);
            sf_add(P + at * N, -moved, P + i * N, N);
            for (int l = 0; l < N; l++) P[l * N + at] -= moved * P[l * N + i];
        }
        tare->moved[i] += moved;
    }
}

/* ------------------------------------------------------------------------------------------------- filter */

SF_API void sf_copy_modes(const sf_config *c, const sf_moment_config *m, sf_modes *to, const sf_modes *from) {
    int N = sf_states(c, m);
    sf_copy(to->mean, from->mean, SF_MODES * N);
    sf_copy(to->covariance, from->covariance, SF_MODES * N * N);
    sf_copy(to->chance, from->chance, SF_MODES);
    sf_copy(to->com_shift, from->com_shift, 2);
}

SF_API void sf_copy_published(const sf_config *c, sf_publication *to, const sf_publication *from) {
    int M = sf_weighed(c);
    sf_copy(to->mean, from->mean, M);
    sf_copy(to->covariance, from->covariance, M * M);
    sf_copy(to->undetermined, from->undetermined, c->channels);
}

SF_API void sf_copy_known(const sf_config *c, const sf_moment_config *m, sf_known_then *to, const sf_modes *belief,
                          const sf_publication *published, const sf_tares *tare) {
    sf_copy_modes(c, m, &to->belief, belief);
    sf_copy_published(c, &to->published, published);
    to->tare = *tare;
}

/* Blocks.break_off: forget the samples that wait, and what the momentum is. */
SF_API void sf_break(const sf_config *c, const sf_moment_config *m, sf_moment_state *s) {
    sf_track_begin(m, &s->track);
    memset(s->pending, 0, (size_t)(m->capacity * sf_waiting(c)) * sizeof(sf_real));
    s->waiting = -1;
    s->linked = 0;
}

/* MomentFilter._age: let scales and zeros drift for a time in s. */
SF_API void sf_age(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, sf_real duration) {
    int K = c->channels, N = sf_states(c, m);
    sf_real time = s->tare.rate * s->tare.rate * duration;
    for (int j = 0; j < SF_MODES; j++)
        for (int i = 0; i < K; i++) {
            sf_real *P = s->belief.covariance + j * N * N;
            P[i * N + i] += m->walk[i] * time;
            P[(2 * K + i) * N + 2 * K + i] += m->walk[K + i] * time * sf_power2(s->published.mean[i]);
        }
    s->drifted += m->walk[0] * time;
    s->time += duration;
}

/* MomentFilter._weigh: hold what a mode is about against severities, in w->compared: all, or those with weight in `of`. */
SF_API int sf_weigh(const sf_config *c, const sf_moment_config *m, const sf_modes *s, int mode, const sf_compared *of,
                    sf_moment_work *w) {
    int N = sf_states(c, m);
    return sf_compare(c, s->mean + mode * N, s->covariance + mode * N * N, N, of, w, &w->compared[mode]);
}

/* MomentFilter.retract: take back what was learnt of late. */
SF_API void sf_moment_retract(const sf_config *c, const sf_moment_config *m, sf_moment_state *s) {
    sf_break(c, m, s);
    sf_copy_modes(c, m, &s->belief, &s->kept.belief);
    sf_copy_published(c, &s->published, &s->kept.published);
    /* How fast zeros drift was seen, whatever came of it. */
    s->kept.tare.rate = s->tare.rate, s->kept.tare.followed = s->tare.followed;
    s->tare = s->kept.tare;
    sf_copy_known(c, m, &s->next, &s->belief, &s->published, &s->tare);
    sf_map_covariance(c, m, &s->published, s->tare.rate, s->covariance);
    s->age = 0;
}

/* Tare.repeat: tare the feet once more as they read last, with a belief that knows nothing yet. */
SF_API void sf_repeat_tares(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, sf_moment_work *w) {
    int channels[SF_CHANNELS], count = 0;
    sf_real reading[SF_CHANNELS], noise[SF_CHANNELS], none[SF_CHANNELS] = {0};
    for (int i = 0; i < c->channels; i++) {
        sf_real last = s->tare.time[c->foot_of_channel[i]];
        if (last < 0 || s->faults.lost[i] > (sf_real)0.5) continue;
        noise[count] = s->tare.rough[c->foot_of_channel[i]] * m->tare_variance[i] / m->block;
        noise[count] += (1 - s->tare.sure[c->foot_of_channel[i]]) * m->loaded[i];
        noise[count] += s->tare.rate * s->tare.rate * m->walk[c->channels + i] * (s->time - last);
        reading[count] = s->tare.reading[i] + s->tare.moved[i];
        channels[count++] = i;
    }
    sf_learn_tare(c, m, &s->belief, channels, count, reading, none, noise, w);
}

/* MomentFilter.init and _begin_again: know nothing but the readings' faults and what feet in the air showed. */
SF_API void sf_moment_begin(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, sf_real rate,
                            sf_moment_work *w) {
    int K = c->channels, N = sf_states(c, m);
    sf_break(c, m, s);
    memset(&s->suspects, 0, sizeof s->suspects);
    memset(&s->versus_start, 0, sizeof s->versus_start);
    for (int i = 0; i < K; i++) s->suspects.known[i] = 1;
    for (int r = 0; r < m->components; r++) s->suspects.noise[r] = 1;
    memset(s->belief.mean, 0, (size_t)(SF_MODES * N) * sizeof(sf_real));
    memset(s->belief.covariance, 0, (size_t)(SF_MODES * N * N) * sizeof(sf_real));
    memset(s->belief.com_shift, 0, sizeof s->belief.com_shift);
    s->age = s->drifted = 0;
    s->status = 0;
    for (int j = 0; j < SF_MODES; j++) {
        sf_real *P = s->belief.covariance + j * N * N;
        for (int i = 0; i < N; i++) P[i * N + i] = m->first_variance[i];
        for (int i = 0; i < K; i++) s->belief.mean[j * N + i] = 1;
        s->belief.chance[j] = m->first_chance[j];
    }
    sf_repeat_tares(c, m, s, w);
    sf_priors(c, m, s->drifted, w);
    for (int j = 0; j < SF_MODES; j++) sf_weigh(c, m, &s->belief, j, NULL, w);
    sf_moment_publish(c, m, &s->belief, w, &s->published);
    sf_map_covariance(c, m, &s->published, rate, s->covariance);
    sf_copy_known(c, m, &s->kept, &s->belief, &s->published, &s->tare);
    sf_copy_known(c, m, &s->next, &s->belief, &s->published, &s->tare);
}

/* MomentFilter.init: the state before any sample. */
SF_API void sf_moment_init(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, sf_moment_work *w) {
    sf_front_init(c, &s->front);
    sf_channel_faults_init(c, &s->faults, s->front.raw);
    memset(s->before, 0, sizeof s->before);
    memset(s->point, 0, sizeof s->point);
    memset(s->shift, 0, sizeof s->shift);
    memset(&s->tare, 0, sizeof s->tare);
    memset(&s->still, 0, sizeof s->still);
    memset(&s->tilt, 0, sizeof s->tilt);
    s->still.time = -1;
    s->tare.rate = m->first_rate;
    for (int foot = 0; foot < c->feet; foot++) s->tare.time[foot] = -1, s->tare.rough[foot] = m->roughest;
    s->time = 0;
    sf_moment_begin(c, m, s, 1, w);
}

/* Places of suspects: channels that are out, flipped ones behind, pairs straight, and pairs crossed. */
SF_API int sf_pairs_of_cells(const sf_config *c) {
    int n = 0;
    for (int i = 0; i < c->channels; i++) n += c->cells[i];
    return n * (n - 1) / 2;
}
SF_API int sf_suspects_of(const sf_config *c) { return 2 * c->channels + 2 * sf_pairs_of_cells(c); }

/* MomentFilter._rest: keep what is known now and then, and learn how cells share loads. */
SF_API void sf_rest(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, sf_moment_work *w, int n,
                    sf_real duration, int good) {
    int K = c->channels, wide = sf_waiting(c);
    sf_real a[SF_CHANNELS], b[SF_CHANNELS], most = 0;
    sf_line(c, &s->published, a, b);
    for (int t = 0; t < n; t++)
        for (int i = 0; i < K; i++) w->force[t * K + i] = a[i] * s->pending[t * wide + i] * c->weight + b[i];
    sf_fault_learn(c, &s->faults, w->force, n, good);
    for (int suspect = 0; suspect < sf_suspects_of(c); suspect++) most = sf_max(most, s->suspects.score[suspect]);
    if (s->age + duration >= m->kept_time && most < m->contrast) {
        sf_copy_known(c, m, &s->kept, &s->next.belief, &s->next.published, &s->next.tare);
        sf_copy_known(c, m, &s->next, &s->belief, &s->published, &s->tare);
        s->age = 0;
    } else s->age += duration;
}

/* MomentFilter._lasting: variances of forces in W^2 that last and that no unknown stands for. */
SF_API void sf_lasting(const sf_config *c, const sf_moment_config *m, const sf_moment_state *s, const sf_tares *tare,
                       sf_real *lasting) {
    int K = c->channels, M = sf_weighed(c);
    sf_real longest = sf_max(m->product_time / (2 * m->mode_time[0]), 1);
    for (int i = 0; i < K; i++) {
        sf_real since = s->time - sf_max(tare->time[c->foot_of_channel[i]], 0);
        sf_real longer = sf_max(sf_min(since, m->product_time) / (2 * m->mode_time[0]), 1);
        sf_real drifted = m->walk[K + i] * (tare->rate * tare->rate) * since;
        drifted = sf_min(drifted, s->published.covariance[(2 * K + i) * M + 2 * K + i]);
        lasting[i] = longer * s->published.covariance[i * M + i] * drifted;
        lasting[i] += longest * sf_power2(s->faults.spare_std[i] / c->weight);
    }
}

/* begin_momentum: let the momentum begin with what is measured at the block's end. */
SF_API void sf_begin_momentum(const sf_config *c, const sf_moment_config *m, const sf_moment_rows *rows, sf_modes *s) {
    int C = m->components, N = sf_states(c, m), at = sf_momenta(c, m);
    for (int j = 0; j < SF_MODES; j++) {
        sf_real *mean = s->mean + j * N, *P = s->covariance + j * N * N;
        sf_begin(mean, P, N, at, 2 * C);
        sf_copy(mean + at, rows->at_end, C);
        for (int r = 0; r < C; r++) {
            P[(at + C + r) * N + at + C + r] = sf_wrench_variance(m, rows, j, r);
            sf_copy(P + (at + r) * N + at, rows->variance + r * C, C);
        }
    }
}

/* ---------------------------------------------------------------------------------------------- suspects */

/* The channels that each suspect is about. */
SF_API void sf_suspected(const sf_config *c, int both[SF_SUSPECTS][2]) {
    int K = c->channels, pair = 2 * K, pairs = sf_pairs_of_cells(c);
    for (int suspect = 0; suspect < pair; suspect++) both[suspect][0] = both[suspect][1] = suspect % K;
    for (int i = 0; i < K; i++)
        for (int j = i + 1; c->cells[i] && j < K; j++) {
            if (!c->cells[j]) continue;
            both[pair][0] = both[pair + pairs][0] = i, both[pair][1] = both[pair + pairs][1] = j;
            pair++;
        }
}

/* The factor of the covariance S and what else is unsure, of each channel a deviation that acts by `reach` or none;
   returns half the logarithm of its determinant, NaN where there is none. */
SF_API sf_real sf_factor(const sf_moment_config *m, const sf_real *S, const sf_real *reach, int K, const sf_real *std,
                         sf_real *L) {
    int C = m->components;
    sf_real size = 0;
    sf_copy(L, S, C * C);
    for (int i = 0; std && i < K; i++)
        for (int r = 0; std[i] != 0 && r < C; r++)
            for (int k = 0; k < C; k++) L[r * C + k] += reach[r * K + i] * std[i] * (reach[k * K + i] * std[i]);
    if (!sf_cholesky(L, C, C)) return (sf_real)NAN;
    for (int r = 0; r < C; r++) size += sf_log(L[r * C + r]);
    return size;
}

/* The logarithm of the likelihood of an innovation, by the factor of its covariance and its size. */
SF_API sf_real sf_evidence(const sf_moment_config *m, const sf_real *L, sf_real size, const sf_real *e) {
    int C = m->components;
    sf_real x[SF_COMPONENTS], square = 0;
    for (int r = 0; r < C; r++) {
        x[r] = e[r];
        for (int k = 0; k < r; k++) x[r] -= L[k * C + r] * x[k];
        x[r] /= L[r * C + r];
        square += x[r] * x[r];
    }
    return (sf_real)-0.5 * square - size;
}

/* Suspects._error: what is left unexplained of rows. */
SF_API void sf_unexplained(const sf_config *c, const sf_moment_config *m, const sf_moment_rows *rows,
                           const sf_real *before, const sf_real *known, sf_real *e) {
    int K = c->channels, N = sf_states(c, m);
    for (int r = 0; r < m->components; r++) {
        const sf_real *H = rows->mean + r * N;
        sf_real explained = rows->mean_rest[r] + sf_dot(H + 3 * K, known + 3 * K, 4 + m->talks);
        for (int i = 0; i < K; i++) {
            explained += rows->crossed[(r * K + i) * K + i] * known[i] + H[K + i] * (known[K + i] + known[2 * K + i]);
        }
        e[r] = rows->measured[r] - before[r] - explained;
    }
}

/* Suspects._changes of one suspect, which is taken off an error. */
SF_API void sf_less_suspect(const sf_config *c, const sf_moment_config *m, const sf_moment_rows *rows,
                            const sf_real *known, const sf_real *others, int suspect, const int both[2], sf_real *e) {
    int K = c->channels, N = sf_states(c, m), pairs = sf_pairs_of_cells(c), i = both[0], j = both[1];
    const sf_real *a = known;
    for (int r = 0; r < m->components; r++) {
        const sf_real *X = rows->crossed + r * K * K, *reach = rows->mean + r * N + K;
        sf_real change = 0, sign = suspect < 2 * K + pairs ? 1 : -1;
        for (int l = 0; suspect < K && l < K; l++) {
            sf_real zero = known[K + l] + known[2 * K + l], by = others[i * K + l] - (l == i);
            change += by * (X[i * K + l] * a[l] + reach[i] * zero);
        }
        if (suspect >= K && suspect < 2 * K) change = -2 * a[i] * X[i * K + i];
        if (suspect >= 2 * K)
            change = sign * (a[i] * X[i * K + j] + a[j] * X[j * K + i]) - a[i] * X[i * K + i] - a[j] * X[j * K + j];
        e[r] -= change;
    }
}

/* Suspects._find_leap: the step of readings that explains an error best; returns whether there is one that does so better
   than `least`. */
SF_API int sf_find_leap(const sf_config *c, const sf_moment_config *m, const sf_suspects *s, const sf_real *S,
                        const sf_real *reach, const sf_real *e, const sf_real *lost, sf_real least, sf_real rare,
                        sf_leap *leap) {
    int K = c->channels, C = m->components, found = 0;
    sf_real L[SF_COMPONENTS * SF_COMPONENTS], most = least, left[SF_COMPONENTS], by[SF_CHANNELS], std[SF_CHANNELS];
    sf_real smallest = m->smallest_step * m->smallest_step, all = 0;
    for (int i = 0; i < K; i++) all += lost[i] < (sf_real)0.5;
    for (int at = 0; at < 2 * m->capacity; at++) {
        const sf_real *old = s->force + at * K, *now = old + 2 * K; /* brought to one moment, between two readings each */
        for (int of = -1; of < c->feet; of++) {
            sf_real mean = 0, count = 0, size = 0, leaps[SF_CHANNELS];
            for (int i = 0; i < K; i++) {
                sf_real step = now[i] - old[i];
                leaps[i] = (of < 0 || c->foot_of_channel[i] == of) && lost[i] < (sf_real)0.5;
                mean += leaps[i] * step, size += leaps[i] * step * step, count += leaps[i];
            }
            count = sf_max(count, 1);
            mean /= count, size /= count;
            for (int tared = 0; tared < 2; tared++) {
                sf_real unlike = 0, largest = 0, variance, seen;
                for (int i = 0; i < K; i++) {
                    by[i] = leaps[i] * (tared ? -old[i] : mean), largest = sf_max(largest, sf_fabs(by[i]));
                    unlike += leaps[i] * sf_power2(now[i] - old[i] - by[i]) / count;
                }
                variance = sf_max(sf_max(unlike, m->alike * m->alike * size), smallest);
                /* Loads that step do so each by its own, and by any size. */
                seen = count * sf_log(sf_max(size, smallest) / variance) / 2;
                /* A push on a robot that stands evenly comes on all of its cells alike. */
                if (count == all) seen += rare;
                if (!(seen > m->contrast && largest <= (tared ? m->largest_tared : m->largest_load))) continue;
                sf_copy(left, e, C);
                for (int i = 0; i < K; i++) {
                    std[i] = leaps[i] * sf_fabs(s->known[i]) * sf_sqrt(variance);
                    for (int r = 0; r < C; r++) left[r] += reach[r * K + i] * (s->known[i] * by[i]);
                }
                seen += sf_evidence(m, L, sf_factor(m, S, reach, K, std, L), left);
                if (!(seen > most)) continue;
                most = seen, found = 1;
                for (int i = 0; i < K; i++) {
                    leap->reading[i] = by[i];
                    leap->std[i] = leaps[i] * sf_sqrt(variance);
                }
            }
        }
    }
    return found;
}

/* Suspects.weigh: hold all suspects against a block; returns who is guilty, -1 for nobody, -2 for a leap. `known` are
   the unknowns before the momentum, `map` the covariance of what is handed out, P that of the likeliest mode. */
SF_API int sf_weigh_suspects(const sf_config *c, const sf_moment_config *m, sf_suspects *s,
                             const sf_channel_faults *faults, const sf_moment_rows *rows, const sf_real *known,
                             const sf_real *map, const sf_real *P, sf_leap *leap) {
    int K = c->channels, C = m->components, N = sf_states(c, m), M = sf_weighed(c), at = sf_momenta(c, m);
    int count = sf_suspects_of(c), best = 0, leaps, both[SF_SUSPECTS][2];
    sf_real rare = sf_log(m->rates[m->held] * rows->duration); /* how rarely a hand pushes in a block */
    sf_real S[SF_COMPONENTS * SF_COMPONENTS], other[SF_COMPONENTS * SF_COMPONENTS], e[SF_COMPONENTS], far[SF_COMPONENTS], changed[SF_COMPONENTS];
    sf_real reach[SF_COMPONENTS * SF_CHANNELS], others[SF_CHANNELS * SF_CHANNELS], others_std[SF_CHANNELS];
    sf_real L[SF_COMPONENTS * SF_COMPONENTS], sound[SF_COMPONENTS * SF_COMPONENTS]; /* factors */
    sf_real before[SF_COMPONENTS], along[SF_WEIGHED], by_robot[4 + SF_TALKS], nothing, lasting, changing, unknown, innocent, least, most = 0, rival = 0;
    sf_others(c, faults, others, others_std);
    sf_suspected(c, both);
    sf_unexplained(c, m, rows, s->before, known, e);
    sf_unexplained(c, m, rows, s->before, s->known, before);
    for (int r = 0; r < C; r++) {
        const sf_real *H = rows->mean + r * N;
        sf_copy(reach + r * K, H + K, K);
        for (int i = 0; i < M; i++) along[i] = sf_dot(map + i * M, H, M);
        for (int i = 0; i < 4 + m->talks; i++)
            by_robot[i] = sf_dot(P + (3 * K + i) * N + 3 * K, H + 3 * K, 4 + m->talks);
        for (int k = 0; k < C; k++) {
            const sf_real *row = rows->mean + k * N;
            S[r * C + k] = 2 * rows->variance[r * C + k] + rows->walk[r * C + k] + sf_dot(row, along, M) +
                           sf_dot(row + 3 * K, by_robot, 4 + m->talks);
            S[r * C + k] *= sf_sqrt(s->noise[r]) * sf_sqrt(s->noise[k]);
        }
        S[r * C + r] += H[at + C + r] * H[at + C + r] * sf_wrench_variance(m, rows, 0, r);
    }
    /* Nothing is wrong; what acted in the last block still acts, or changes as a hand's force does, as rarely as somebody
       takes hold; a force as large as the weight acts on the robot's body, up to its height away from its
       centre of mass. */
    sf_real size = sf_factor(m, S, reach, K, 0, sound);
    nothing = sf_evidence(m, sound, size, e);
    for (int i = 0; i < C * C; i++) other[i] = 2 * S[i];
    for (int r = 0; r < C; r++) changed[r] = e[r] - s->error[r] * rows->mean[r * N + at + C + r];
    lasting = sf_evidence(m, L, sf_factor(m, other, reach, K, 0, L), changed);
    for (int r = 0; r < C; r++) {
        sf_real span = rows->mean[r * N + at + C + r], decay = sf_exp(-rows->duration / m->mode_time[m->held]);
        far[r] = e[r] - decay * s->error[r] * span;
        other[r * C + r] += span * span * (1 - decay * decay) * sf_wrench_variance(m, rows, m->held, r);
    }
    changing = sf_evidence(m, L, sf_factor(m, other, reach, K, 0, L), far) + rare;
    sf_copy(other, S, C * C);
    for (int r = 0; r < C; r++) {
        sf_real arm = rows->mean[r * N + at + C + r] * (r == 0 ? 0 : r > 2 && r < 5 ? 1 : rows->height);
        for (int k = 0; k < C; k++) other[r * C + k] += rows->mean_rest[r] * rows->mean_rest[k];
        other[r * C + r] += arm * arm;
    }
    unknown = sf_evidence(m, L, sf_factor(m, other, reach, K, 0, L), e);
    innocent = sf_max(sf_max(nothing, lasting), sf_max(changing, unknown));
    if (!sf_finite(innocent)) return -1;
    least = innocent + m->sure;
    for (int suspect = 0; suspect < count; suspect++) {
        sf_real std[SF_CHANNELS] = {0}, score;
        int shown = 0;
        if (suspect < 2 * K && !c->cells[suspect % K]) continue;
        if (sf_lost_of_plate(c, faults, both[suspect][0]) + sf_lost_of_plate(c, faults, both[suspect][1]) > (sf_real)0.5) {
            s->score[suspect] = 0;
            continue;
        }
        sf_copy(far, before, C);
        sf_less_suspect(c, m, rows, s->known, others, suspect, both[suspect], far);
        if (suspect < K) {
            std[suspect] = others_std[suspect] / c->weight;
            score = sf_evidence(m, L, sf_factor(m, S, reach, K, std, L), far);
        } else score = sf_evidence(m, sound, size, far);
        least = sf_max(least, score);
        score -= innocent;
        for (int r = 0; r < C; r++) {
            sf_real arm = rows->mean[r * N + at + C + r] * (r == 0 || (r > 2 && r < 5) ? 1 : rows->height);
            shown = shown || sf_fabs(before[r] - far[r]) > m->least_error * arm;
        }
        score = s->score[suspect] + (shown ? score : sf_min(score, 0));
        s->score[suspect] = score > 0 ? score : 0;
        most = sf_max(most, s->score[suspect]);
    }
    leaps = innocent > nothing && sf_find_leap(c, m, s, S, reach, before, faults->lost, least, rare, leap);
    if (most < m->contrast) {
        sf_copy(s->known, known, at);
        for (int r = 0; r < C; r++) {
            /* An error that surely stays is no noise, as the whole weight of a robot that hangs on a crane. */
            sf_real surprise = lasting > nothing + m->contrast ? changed[r] * changed[r] / 2 : e[r] * e[r];
            surprise = sf_min(surprise / S[r * C + r], m->suspect_surprise);
            s->noise[r] = sf_clip(s->noise[r] * (1 + m->suspect_share * (surprise - 1)), m->suspect_noise[0], m->suspect_noise[1]);
        }
    }
    for (int r = 0; r < C; r++) s->error[r] = e[r] / rows->mean[r * N + at + C + r];
    if (leaps) return -2;
    /* To put a channel right is preferred to losing it. */
    for (int suspect = 1; suspect < count; suspect++)
        if (s->score[suspect] - (suspect < K) * m->contrast > s->score[best] - (best < K) * m->contrast) best = suspect;
    if (!(s->score[best] - (best < K) * m->contrast > m->sure)) return -1;
    for (int suspect = 0; suspect < count; suspect++) {
        int related = 0;
        for (int i = 0; i < 4; i++) related = related || both[best][i / 2] == both[suspect][i % 2];
        if (!related) rival = sf_max(rival, s->score[suspect] - (suspect < K) * m->contrast);
    }
    return s->score[best] - (best < K) * m->contrast > rival + m->contrast ? best : -1;
}

/* Suspects.miss and ChannelFaults.miss: note the momentum that the starting map, tared, leaves unexplained. */
SF_API void sf_miss(const sf_config *c, const sf_moment_config *m, sf_channel_faults *faults, const sf_moment_rows *rows,
                    const sf_real *before, const sf_tares *tare, const sf_real *about) {
    int K = c->channels;
    sf_real known[SF_KNOWN], e[SF_COMPONENTS], left[SF_COMPONENTS];
    sf_copy(known, about, sf_momenta(c, m));
    for (int i = 0; i < K; i++) known[i] = 1, known[K + i] = -tare->reading[i], known[2 * K + i] = 0;
    sf_unexplained(c, m, rows, before, known, e);
    for (int i = 0; i < K; i++) {
        int both[2] = {i, i};
        sf_copy(left, e, m->components);
        sf_less_suspect(c, m, rows, known, c->by_others, i, both, left);
        for (int r = 0; r < m->components; r++) {
            sf_real arm = sf_is_force(r) ? 1 : rows->height, by = (e[r] - left[r]) / arm;
            faults->missed[i] += e[r] / arm * by;
            faults->offered[i] += by * by;
        }
    }
}

/* Suspects.read: note the readings of a block. */
SF_API void sf_read_suspects(const sf_config *c, const sf_moment_config *m, sf_suspects *s, const sf_real *samples, int n) {
    int K = c->channels, wide = sf_waiting(c), kept = 2 * m->capacity + 2;
    memmove(s->force, s->force + n * K, (size_t)((kept - n) * K) * sizeof(sf_real));
    for (int t = 0; t < n; t++) sf_copy(s->force + (kept - n + t) * K, samples + t * wide, K);
}

/* VersusStart._residual, as a mean force in W and a mean torque in W m: of the map x, or of the start if x is NULL. */
SF_API void sf_residual(const sf_config *c, const sf_moment_config *m, const sf_moment_rows *rows, const sf_real *before,
                        const sf_real *x, const sf_real *span, sf_real *e) {
    int K = c->channels, N = sf_states(c, m);
    for (int r = 0; r < m->components; r++) {
        sf_real explained = rows->mean_rest[r];
        for (int i = 0; i < K; i++)
            explained += rows->crossed[(r * K + i) * K + i] * (x ? x[i] : 1) +
                         (x ? rows->mean[r * N + K + i] * (x[K + i] + x[2 * K + i]) : 0);
        e[r] = (rows->measured[r] - before[r] - explained) / span[r];
    }
}

/* Residuals.include and excess: take in a row, and return the mean square that an error of the robot's own model does
   not explain. */
SF_API sf_real sf_include(sf_real *mean, sf_real *square, sf_real e, sf_real share, sf_real slack, sf_real floor) {
    sf_real beyond, varying;
    *mean += share * (e - *mean);
    *square += share * (e * e - *square);
    beyond = sf_max(sf_fabs(*mean) - slack, 0);
    varying = sf_max(*square - *mean * *mean, 0);
    return varying + beyond * beyond + floor;
}

/* VersusStart.take: compare the published map with the start by a block that neither was learnt from. */
SF_API void sf_take_versus_start(const sf_config *c, const sf_moment_config *m, const sf_moment_rows *rows,
                                 const sf_real *before, const sf_real *learnt, int held, const sf_real *com_shift,
                                 sf_versus_start *s) {
    int C = m->components, N = sf_states(c, m), at = sf_momenta(c, m) + C;
    sf_real span[SF_COMPONENTS], floor[SF_COMPONENTS], now[SF_COMPONENTS], then[SF_COMPONENTS], slacks[SF_COMPONENTS], share, total = 0;
    for (int r = 0; r < C; r++) {
        sf_real added = r == 1 || r == 2 ? sf_power2(m->versus_factor) * sf_max(sf_power2(com_shift[0]), sf_power2(com_shift[1])) : 0;
        slacks[r] = sf_sqrt(sf_power2(m->versus_slack[r]) + added);
        span[r] = rows->mean[r * N + at + r];
        floor[r] = (2 * rows->variance[r * C + r] + rows->walk[r * C + r]) / (span[r] * span[r]);
    }
    sf_residual(c, m, rows, before, learnt, span, now);
    sf_residual(c, m, rows, before, NULL, span, then);
    for (int r = 0; held && r < C; r++)
        if (sf_fabs(then[r]) > slacks[r] + m->versus_explained * sf_sqrt(floor[r])) return;
    s->time = sf_min(s->time + rows->duration, m->versus_memory);
    share = rows->duration / s->time;
    for (int r = 0; r < C; r++) {
        sf_real slack = slacks[r], counts, noise, q;
        s->precision[r] += share * (1 / floor[r] - s->precision[r]);
        counts = share / (floor[r] * s->precision[r]), noise = 1 / s->precision[r];
        q = sf_include(s->learnt_mean + r, s->learnt_square + r, now[r], counts, slack, noise);
        total += sf_log(q / sf_include(s->start_mean + r, s->start_square + r, then[r], counts, slack, noise));
    }
    s->evidence = (sf_real)0.5 * s->time / m->versus_independent * total;
}

/* Repairs.weigh: hold the readings' faults against the block of w->rows. */
SF_API int sf_suspect(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, int n, const sf_real step[3],
                      const sf_real *published, int likeliest, sf_moment_work *w) {
    int K = c->channels, N = sf_states(c, m), M = sf_weighed(c), guilty;
    sf_real known[SF_KNOWN], rest[3] = {0, 0, 0};
    sf_move_momentum(c, m, step, w->rows.velocity, s->suspects.before);
    sf_move_momentum(c, m, step, rest, s->suspects.error);
    sf_copy(known, published, M);
    sf_copy(known + M, w->belief.mean + likeliest * N + 3 * K, 4 + m->talks);
    sf_read_suspects(c, m, &s->suspects, s->pending, n);
    sf_take_versus_start(c, m, &w->rows, s->suspects.before, s->published.mean, likeliest == m->held, w->belief.com_shift,
                         &s->versus_start);
    sf_miss(c, m, &s->faults, &w->rows, s->suspects.before, &s->tare, known);
    guilty = sf_weigh_suspects(c, m, &s->suspects, &s->faults, &w->rows, known, s->published.covariance,
                               w->belief.covariance + likeliest * N * N, &w->leap);
    sf_copy(s->suspects.before, w->rows.at_end, m->components);
    return guilty;
}

/* Repairs.repair: put right what is wrong, and drop what was learnt of it; -2 is a leap. */
SF_API void sf_convict(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, int guilty,
                       const sf_leap *leap) {
    int K = c->channels, N = sf_states(c, m), each[SF_SUSPECTS][2], *both = each[guilty < 0 ? 0 : guilty];
    memset(s->suspects.score, 0, sizeof s->suspects.score);
    for (int i = 0; i < K; i++)
        s->faults.shown[i] = -1, s->faults.expected[i] = s->faults.missed[i] = s->faults.offered[i] = 0;
    sf_moment_retract(c, m, s);
    if (guilty < 0) {
        for (int i = 0; i < K; i++) {
            sf_real variance = sf_power2(s->published.mean[i] * leap->std[i]), by = leap->reading[i] * c->weight;
            for (int t = 0; t <= c->kept; t++) s->front.history[t * 3 * K + i] -= by;
            s->shift[i] += by;
            for (int j = 0; j < SF_MODES; j++) s->belief.covariance[j * N * N + (2 * K + i) * (N + 1)] += variance;
        }
        return;
    }
    sf_suspected(c, each);
    if (guilty < K) {
        int fresh[SF_CHANNELS] = {0}, kind[SF_CHANNELS] = {0};
        fresh[guilty] = 1, kind[guilty] = SF_DEAD;
        sf_lose(c, &s->faults, fresh, kind);
        return;
    }
    sf_real row[SF_CHANNELS], sign = guilty < 2 * K || guilty >= 2 * K + sf_pairs_of_cells(c) ? -1 : 1;
    sf_real *one = s->faults.wiring + both[0] * K, *two = s->faults.wiring + both[1] * K, shift = s->shift[both[0]];
    s->faults.altered = 1;
    sf_copy(row, one, K);
    for (int j = 0; j < K; j++) one[j] = sign * two[j];
    s->shift[both[0]] = sign * s->shift[both[1]];
    s->faults.kind[both[0]] ^= guilty < 2 * K ? SF_FLIPPED : SF_SWAPPED;
    if (both[0] == both[1]) return;
    for (int j = 0; j < K; j++) two[j] = sign * row[j];
    s->shift[both[1]] = sign * shift;
    s->faults.kind[both[1]] ^= SF_SWAPPED;
}

/* MomentFilter._follow and _update: take rows in; returns a flag of what forbids it, 0, or less: -3 less who is guilty. */
SF_API int sf_take_rows(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, sf_moment_work *w,
                        int n, const sf_real *published, int *rejected, sf_real *nis) {
    int follows = s->linked && s->track.adrift < m->leg_time;
    int N = sf_states(c, m), wrench = N - m->components, likeliest = 0, good = 1, guilty;
    sf_moment_rows *rows = &w->rows;
    sf_modes *belief = &w->belief;
    sf_priors(c, m, s->drifted, w);
    if (follows) {
        sf_real step[3], ahead, rest[SF_COMPONENTS];
        sf_copy(rest, rows->mean_rest, m->components);
        for (int k = 0; k < 3; k++) step[k] = rows->point[k] - s->point[k];
        sf_moment_move(c, m, step, rows->velocity, belief);
        for (int j = 1; j < SF_MODES; j++)
            if (belief->chance[j] > belief->chance[likeliest]) likeliest = j;
        ahead = rows->measured[0] - sf_dot(rows->mean, belief->mean + likeliest * N, N) - rows->mean_rest[0];
        if (likeliest == m->steady) /* its wrench is known, and no error of the readings */
            for (int r = 0; r < m->components; r++)
                rows->mean_rest[r] += sf_dot(rows->mean + r * N + wrench, belief->mean + likeliest * N + wrench, m->components);
        guilty = sf_suspect(c, m, s, n, step, published, likeliest, w);
        sf_copy(rows->mean_rest, rest, m->components);
        if (guilty != -1) return -3 - guilty;
        *rejected = sf_fabs(ahead) > (sf_real)0.5 * m->largest_error * rows->duration;
    }
    if (!follows || *rejected) {
        sf_begin_momentum(c, m, rows, belief);
        for (int j = 0; j < SF_MODES; j++) good = sf_weigh(c, m, belief, j, NULL, w) && good;
    } else {
        sf_real before[SF_MODES], after[SF_MODES];
        sf_taught taught;
        sf_mix(c, m, belief, rows, &w->mixed);
        for (int j = 0; j < SF_MODES; j++) {
            if (j == m->held) continue; /* it learns nothing of its sensors */
            good = sf_weigh(c, m, &w->mixed, j, NULL, w) && good;
            before[j] = w->compared[j].evidence;
        }
        good = good && sf_moment_learn(c, m, &w->mixed, w, &taught);
        for (int j = 0; good && j < SF_MODES; j++) {
            after[j] = taught.likelihood[j];
            if (j == m->held) continue;
            good = sf_weigh(c, m, &w->mixed, j, &w->compared[j], w);
            after[j] += w->compared[j].evidence - before[j];
        }
        if (!good || !sf_all_finite(after, SF_MODES)) return SF_SINGULAR;
        sf_weigh_modes(m, after, w->mixed.chance);
        if (sf_published(m, &w->mixed, m->held)) good = sf_weigh(c, m, &w->mixed, m->held, NULL, w);
        *nis = taught.nis;
        belief = &w->mixed;
        good = good && sf_all_finite(belief->mean, SF_MODES * N) && sf_all_finite(belief->covariance, SF_MODES * N * N);
    }
    if (!good) return SF_SINGULAR;
    if (!s->linked) {
        sf_read_suspects(c, m, &s->suspects, s->pending, n);
        sf_copy(s->suspects.before, rows->at_end, m->components);
    }
    sf_moment_publish(c, m, belief, w, &w->published);
    if (!sf_all_finite(w->published.mean, sf_weighed(c))) return SF_SINGULAR;
    sf_copy_modes(c, m, &s->belief, belief);
    return 0;
}

/* MomentFilter._learn: learn from the block that is full; how its innovation compares, and how many rows it had. */
SF_API void sf_moment_block(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, sf_moment_work *w,
                              sf_real *nis, sf_real *nis_rows) {
    int K = c->channels, M = sf_weighed(c), wide = sf_waiting(c), n = (int)s->waiting - 1, held = 0, missing = 0, out = 0, rejected = 0;
    sf_real duration = 0, lost[SF_CHANNELS], published[SF_WEIGHED], lasting[SF_CHANNELS];
    sf_tares tare;
    for (int t = 0; t < n; t++) duration += s->pending[t * wide + sf_at_dt(c)];
    sf_age(c, m, s, duration);
    sf_copy(lost, s->faults.lost, K);
    if (sf_silent(c, &s->faults, s->pending, s->pending + K, wide, n, c->weight)) {
        /* All that was learnt made up for a cell that bore nothing. */
        sf_moment_begin(c, m, s, s->tare.rate, w);
        return;
    }
    for (int i = 0; i < K; i++) {
        if (s->faults.lost[i] > lost[i]) {
            /* What was learnt of late was learnt from wrong readings. */
            sf_moment_retract(c, m, s);
            return;
        }
    }
    s->status = 0;
    for (int i = 0; i < K; i++) {
        sf_real read = 0;
        for (int t = 0; t < n; t++) read += s->pending[t * wide + K + i];
        missing = missing || (read / (sf_real)n < m->least_read && s->faults.lost[i] < (sf_real)0.5);
        out = out || sf_lost_of_plate(c, &s->faults, i) > (sf_real)1.5;
    }
    if (missing) s->linked = 0;
    else {
        sf_copy_modes(c, m, &w->belief, &s->belief);
        sf_copy(published, s->published.mean, M);
        tare = s->tare;
        sf_take_still(c, m, s, n, duration, &w->belief, published, &s->still, &tare);
        int wrong = 0, good = sf_take_tare(c, m, s, n, duration, &w->belief, published, &tare, w, &wrong);
        int flag = good ? 0 : SF_SINGULAR;
        if (wrong) {
            s->tare = tare;
            sf_moment_begin(c, m, s, tare.rate, w);
            return;
        }
        if (out) {
            /* Nothing stands in for two cells of a plate; zeros are seen without them. */
            sf_copy(s->published.mean, published, M);
            s->linked = 0;
        } else {
            sf_lasting(c, m, s, &tare, lasting);
            sf_moment_rows_of(c, m, s->pending, n, published, lasting, sf_all_there(c, &s->faults) ? 0 : s->faults.spare, w);
            sf_allow_for_tilt(c, m, &w->rows, &s->tilt, &w->belief);
            if (good) flag = sf_take_rows(c, m, s, w, n, published, &rejected, nis);
            if (flag < 0) {
                *nis = (sf_real)NAN;
                sf_copy(s->before, s->pending + (n - 1) * wide, wide);
                sf_convict(c, m, s, -3 - flag, &w->leap);
                return;
            }
            missing = flag != 0;
            s->linked = !flag && s->track.adrift < m->leg_time;
            s->status = flag;
        }
        if (!out && !missing) {
            held = sf_support_probability(c, m, &s->belief) > m->held_chance;
            sf_copy_published(c, &s->published, &w->published);
            sf_map_covariance(c, m, &s->published, tare.rate, s->covariance);
            sf_copy(s->point, w->rows.point, 3);
            s->tare = tare;
            s->status = rejected ? SF_REJECTED : held ? SF_HELD : 0;
            *nis_rows = (sf_real)m->components;
        } else *nis = (sf_real)NAN;
    }
    sf_rest(c, m, s, w, n, duration, !missing && !out && !s->status);
    sf_copy(s->before, s->pending + (n - 1) * wide, wide);
    sf_copy(s->pending, s->pending + n * wide, wide);
    memset(s->pending + wide, 0, (size_t)((m->capacity - 1) * wide) * sizeof(sf_real));
    s->waiting = 1;
}

/* Blocks._load_below: subtract the load of the feet below their sensors at a sample; a: scales. */
SF_API void sf_take_off(const sf_config *c, const sf_moment_config *m, const sf_real *a, const sf_real *before,
                        sf_real *row, const sf_real *after) {
    int K = c->channels, at = sf_at_sole(c), turned = sf_at_rotation(c);
    sf_real passed = row[sf_at_dt(c)], next = after[sf_at_dt(c)];
    for (int foot = 0; foot < c->feet; foot++) {
        const sf_real *rows[3] = {before, row, after}, *R = row + turned + 9 * foot;
        sf_real x[3][3], felt[3], load[3];
        for (int t = 0; t < 3; t++) {
            sf_turn(x[t], rows[t] + turned + 9 * foot, m->com_below + 3 * foot);
            sf_add(x[t], 1, rows[t] + at + 3 * foot, 3);
        }
        for (int k = 0; k < 3; k++)
            felt[k] = ((x[2][k] - x[1][k]) / next - (x[1][k] - x[0][k]) / passed) / ((passed + next) / 2) +
                      (k == 2 ? c->gravity : 0);
        for (int k = 0; k < 3; k++)
            load[k] = (k == 2 ? c->gravity : 0) - (R[k] * felt[0] + R[3 + k] * felt[1] + R[6 + k] * felt[2]);
        for (int i = 0; i < K; i++)
            if (c->foot_of_channel[i] == foot)
                row[i] -= sf_dot(m->below + 3 * i, load, 3) / sf_clip(a[i], SF_LEAST_LEAP_SCALE, SF_LARGEST_LEAP_SCALE);
    }
}

/* Blocks.collect: put a sample to those that wait. */
SF_API void sf_collect(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, const sf_reference *reference,
                       const sf_real *past, sf_real dt) {
    int K = c->channels;
    const sf_real *motion = s->front.motion;
    sf_real asked[3], *row;
    sf_pose pose;
    if (reference->momentum) sf_follow_momentum(c, &s->track, motion, &pose);
    else {
        sf_follow_accelerations(c, m, &s->track, motion, reference->stance, dt, &pose);
        if (!sf_ground(c, motion, 0, asked)) s->track.velocity[0] = (sf_real)NAN; /* as no robot moves */
    }
    if (!sf_track_plausible(m, &s->track)) {
        sf_break(c, m, s);
        return;
    }
    row = s->waiting < 0 ? s->before : s->pending + s->waiting * sf_waiting(c);
    s->waiting++;
    for (int i = 0; i < K; i++) {
        row[i] = past[i] / c->weight;
        row[K + i] = past[K + i];
    }
    sf_copy(row + sf_at_end(c), pose.end, 3);
    sf_copy(row + sf_at_com(c), pose.com, 3);
    sf_copy(row + sf_at_velocity(c), s->track.velocity, 3);
    sf_copy(row + sf_at_spin(c), s->track.spin, 3);
    sf_copy(row + sf_at_sole(c), pose.sole, 3 * c->feet);
    sf_copy(row + sf_at_rotation(c), pose.rotation, 9 * c->feet);
    for (int foot = 0; foot < c->feet; foot++) row[sf_at_swing(c) + foot] = (sf_real)(reference->swing[foot] != 0);
    row[sf_at_dt(c)] = dt;
    if (s->waiting > 1) {
        const sf_real *before = s->waiting > 2 ? row - 2 * sf_waiting(c) : s->before;
        sf_smooth(c, before, row - sf_waiting(c), row, 1);
        if (m->carries) sf_take_off(c, m, s->published.mean, before, row - sf_waiting(c), row);
    }
}

/* MomentFilter.update: take in one sample.

   raw: K readings, NaN where none arrived. reference: the robot's beliefs `lag` samples ago. dt: time since
   the last sample in s. Values never stop it: what is not finite or not possible is held and flagged.
   Returns whether something new is handed out. */
SF_API int sf_moment_step(const sf_config *c, const sf_moment_config *m, sf_moment_state *s, sf_moment_work *w,
                            const sf_real *raw, const sf_reference *reference, sf_real dt, sf_estimate *estimate) {
    int K = c->channels, full = 0, lies = 1;
    sf_whole kinds[SF_CHANNELS];
    sf_real waited = 0;
    sf_sample sample;
    sf_check(c, &s->front, raw, reference, dt, &sample);
    sf_fault_sample(c, &s->faults, s->published.mean, reference->stance, sample.force, sample.read, kinds);
    for (int i = 0; i < K; i++) {
        sample.force[i] -= s->shift[i];
        /* the others of its plate stand in for one that is out */
        if (s->faults.lost[i] > (sf_real)0.5 && sf_lost_of_plate(c, &s->faults, i) < (sf_real)1.5) s->front.silent[i] = 0;
    }
    sf_align(c, &s->front, &sample);
    if (sample.gap && dt > 0 && sf_finite(dt)) sf_age(c, m, s, sf_min(dt, m->longest_pause));
    for (int foot = 0; foot < c->feet; foot++) lies = lies && sf_rotation(c, s->front.motion, foot)[8] < m->level;
    if (sample.sound && !sample.gap && lies) {
        /* What was learnt as it fell is taken back, once. */
        if (s->track.samples) sf_moment_retract(c, m, s);
        s->status = SF_REJECTED;
    } else if (!sample.sound || sample.gap) sf_break(c, m, s);
    else sf_collect(c, m, s, reference, sample.past, dt);
    if (c->kept > 1) {
        /* The newest reading may still turn out to be an outlier. */
        sf_real *row = s->front.history + (c->kept - 1) * 3 * K;
        sf_smooth(c, row - 3 * K, row, row + 3 * K, c->weight);
    }
    estimate->nis = (sf_real)NAN;
    estimate->nis_rows = 0;
    for (int t = 0; t + 1 < s->waiting; t++) waited += s->pending[t * sf_waiting(c) + sf_at_dt(c)];
    full = s->waiting >= 2 && (waited >= m->block - (sf_real)0.5 * c->dt || s->waiting == m->capacity);
    if (full) {
        sf_moment_block(c, m, s, w, &estimate->nis, &estimate->nis_rows);
        for (int i = 0; i < K; i++) kinds[i] |= s->faults.kind[i];
    }
    for (int i = 0; i < K; i++) sample.flags[i] |= kinds[i];
    sf_moment_estimate(c, m, s, &sample, estimate);
    return full;
}

#endif
