/* What one robot knows of its own motion without its feet's sensors, in C99: packets of joint angles and an
   IMU in, the sf_reference that sf_moment_step takes out.

   The specification is the Python in robot/beliefs/: nominal.py, odometry.py, references.py and contacts.py, whose
   module docstrings derive it; docs/native.md tells how to use this file. Nothing is allocated, nothing is
   global, and nothing is read or written but what is passed in.

       sf_model model;           the robot's bodies and hinges, written by surefoot.robot.beliefs.native
       sf_timing timing;         its packets and samples
       sf_beliefs beliefs;       all that is remembered, a plain record that may be copied
       sf_beliefs_init(&beliefs);
       sf_beliefs_packet(&model, &timing, &beliefs, number, arrival, angle, accelerometer, gyroscope);
       sf_beliefs_sample(&timing, &beliefs, time, planned, hold, &belief);      once a sample of the feet
       sf_moment_step(&config, &moment, &state, &work, raw, &belief.reference, dt, &estimate);

   Moments are doubles whatever SF_SINGLE says: after an hour a float tells no milliseconds apart.

   Before it is included: SF_BODIES, SF_HINGES, SF_PACKETS and SF_PLANNED are the largest sizes; for what
   surefoot_robot.h takes see there. */

#ifndef SUREFOOT_BELIEFS_H
#define SUREFOOT_BELIEFS_H

#include "surefoot_robot.h"

#ifdef SF_SINGLE
#define sf_sin sinf
#define sf_cos cosf
#else
#define sf_sin sin
#define sf_cos cos
#endif

#ifndef SF_BODIES
#define SF_BODIES 64
#endif
#ifndef SF_HINGES
#define SF_HINGES 64
#endif
#ifndef SF_PACKETS
#define SF_PACKETS 64 /* kept: as many as the lag spans, and 3 */
#endif
#ifndef SF_PLANNED
#define SF_PLANNED 64 /* samples for which a plan is kept: the lag less 4, and 1 */
#endif
#if SF_FEET != 2
#error "beliefs are about two feet"
#endif

/* Places of the vectors of a row, see references.py; the last four follow from neighbours or are as measured. */
enum {
    SF_ROW_COM = 0,
    SF_ROW_IMU = 3,
    SF_ROW_SOLES = 6,
    SF_ROW_AXES = 12,
    SF_ROW_MOMENTUM = 30,
    SF_ROW_FORCE = 33,
    SF_ROW_ACCELERATION = 36,
    SF_ROW_RATE = 39,
    SF_ROW_ACCELEROMETER = 42,
    SF_ROW_GYROSCOPE = 45,
    SF_ROW = 48
};

/* Constants of the Python modules, by their names there. */
#define SF_TILT_TIME ((sf_real)0.3)
#define SF_SPIN_BIAS_TIME ((sf_real)3.0)
#define SF_REST_TIME ((sf_real)10.0)
#define SF_FREE_FALL ((sf_real)0.5) /* of gravity */
#define SF_SOLE_HEIGHT ((sf_real)0.003)
#define SF_SLOPE 3
#define SF_FURTHEST 8.0
#define SF_CLOCK_MEMORY 256.0
#define SF_LARGEST_VALUE ((sf_real)1e6)
#define SF_CONTACT_MARGIN 4
#define SF_LIFTED ((sf_real)0.01)
#define SF_DOWN ((sf_real)0.003)
#define SF_FLAT ((sf_real)0.03)
#define SF_COS_FLAT (1 - (sf_real)0.5 * SF_FLAT * SF_FLAT)
#define SF_LEANING ((sf_real)0.4) /* of gravity */
#define SF_LEAN_TIME ((sf_real)0.25)
#define SF_LARGEST_FORCE_BIAS ((sf_real)1.5)
#define SF_LOWEST ((sf_real)0.7)

/* ------------------------------------------------------------------------------------------------ records */

/* The robot as it believes itself to be: a tree of bodies on hinges. Body 0 is the torso, which floats and
   carries the IMU with its axes along its own; parents stand before their children. Matrices by rows. */
typedef struct {
    int bodies, hinges;
    int parent[SF_BODIES];
    int hinge_body[SF_HINGES];    /* in the order of angles, which is that of bodies */
    int site_body[3];             /* of the IMU, the left and the right sole */
    sf_real place[SF_BODIES * 3]; /* of a body's frame in its parent's, hinges at their zero, in m */
    sf_real R_parent_body[SF_BODIES * 9];
    sf_real anchor[SF_HINGES * 3], axis[SF_HINGES * 3], zero[SF_HINGES]; /* in the body's frame; angle, rad */
    sf_real mass[SF_BODIES], com[SF_BODIES * 3]; /* kg; m in the body's frame */
    sf_real inertia[SF_BODIES * 9]; /* about the com, in the body's axes, kg m^2 */
    sf_real position_site[3 * 3], R_body_site[3 * 9];
} sf_model;

/* When packets leave and samples are taken. */
typedef struct {
    int averaged;         /* whether a sample of the IMU is the mean since the packet before */
    int joined;           /* how many packets become one, of which the period is */
    int needed, window;   /* contacts.planned_window: for how long a plan must have held, and what is kept */
    sf_real dt, gravity;  /* time between samples of the feet in s; m/s^2 */
    double period, delay; /* time between packets and their mean delay in s */
} sf_timing;

/* All that is remembered: Beliefs, Odometry, Plan, Kinematics and Upright side by side. */
typedef struct {
    sf_real ring[SF_PACKETS * SF_ROW];
    sf_real angle[SF_HINGES], accelerometer[3], gyroscope[3]; /* the last packet */
    sf_real forward[3], up[3], spin[3], spin_bias[3], force_bias[3];
    sf_real lean[3], highest;
    double clock; /* time in s on the host's clock at which packet 0 left */
    sf_real sum[6]; /* of the IMU over the packets that are being joined */
    sf_whole number, seen, run, count, parts;
    sf_whole planned[SF_PLANNED * 4], found[4], upright; /* samples: left and right stance, then swing */
} sf_beliefs;

/* What the robot believes of one moment; NaN where it knows nothing. */
typedef struct {
    sf_reference reference;
    sf_real accelerometer[3], gyroscope[3]; /* as measured, IMU's axes: m/s^2, rad/s */
    unsigned char known;                    /* whether the reference is of numbers */
    unsigned char fell; /* whether the robot was upright until now: time for sf_moment_retract */
} sf_belief;

/* -------------------------------------------------------------------------------------- vectors of three */

/* out = A B; out is another array. */
SF_API void sf_then(sf_real *out, const sf_real *A, const sf_real *B) {
    for (int i = 0; i < 9; i += 3)
        for (int k = 0; k < 3; k++) out[i + k] = A[i] * B[k] + A[i + 1] * B[3 + k] + A[i + 2] * B[6 + k];
}

/* Scale to length one, unless it has none. */
SF_API void sf_unit_vector(sf_real *a) {
    sf_real square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2], by = 1 / sf_sqrt(square);
    for (int i = 0; square > 0 && i < 3; i++) a[i] *= by;
}

SF_API sf_real sf_power2(sf_real a) { return a * a; }

SF_API sf_real sf_square(const sf_real *a) { return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]; }

/* ------------------------------------------------------------------------------------------------ nominal */

/* out = R turned on by an angle about a unit vector in its own axes (Rodrigues), and `a`, that vector in those around
   it; out may be R. */
SF_API void sf_turn_on(sf_real *out, const sf_real *R, const sf_real *axis, sf_real *a, sf_real sine, sf_real cosine) {
    int k = axis[0] == 1 ? 0 : axis[1] == 1 ? 1 : 2, i = (k + 1) % 3, j = (k + 2) % 3;
    int plain = axis[k] == 1 && axis[i] == 0 && axis[j] == 0; /* most hinges lie along one of the axes */
    for (int r = 0; r < 3; r++, out += 3, R += 3) {
        sf_real x = R[0], y = R[1], z = R[2], u = R[i], v = R[j];
        if (plain) {
            out[k] = a[r] = R[k];
            out[i] = cosine * u + sine * v;
            out[j] = cosine * v - sine * u;
        } else {
            a[r] = x * axis[0] + y * axis[1] + z * axis[2];
            sf_real along = (1 - cosine) * a[r];
            out[0] = cosine * x + sine * (y * axis[2] - z * axis[1]) + along * axis[0];
            out[1] = cosine * y + sine * (z * axis[0] - x * axis[2]) + along * axis[1];
            out[2] = cosine * z + sine * (x * axis[1] - y * axis[0]) + along * axis[2];
        }
    }
}

/* Move a point and its velocity on by an arm in the axes R of a body that turns with w. */
SF_API void sf_reach(sf_real *p, sf_real *v, const sf_real *R, const sf_real *w, sf_real sign, const sf_real *arm) {
    sf_real way[3], speed[3];
    sf_turn(way, R, arm);
    sf_cross(speed, w, way);
    for (int k = 0; k < 3; k++) p[k] += sign * way[k], v[k] += sign * speed[k];
}

/* NominalModel.evaluate: fill a row, in the torso's frame, up to its angular momentum.

   angle, rate: of the hinges in rad and rad/s. spin: angular velocity of the torso in its own axes. speeds: if not
   NULL, NominalModel.velocities, of the centre of mass and then angular velocity and velocity of each site. */
SF_API void sf_evaluate(const sf_model *m, const sf_real *angle, const sf_real *rate, const sf_real *spin,
                        sf_real *row, sf_real *speeds) {
    static const sf_real level[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    sf_real R[SF_BODIES * 9], p[SF_BODIES * 3], v[SF_BODIES * 3], w[SF_BODIES * 3];
    sf_real mass = 0, moment[3] = {0, 0, 0}, linear[3] = {0, 0, 0}, angular[3] = {0, 0, 0};
    sf_real a[3], b[3], turned[9], sine[SF_HINGES], cosine[SF_HINGES];
    int hinge = 0;
    for (int i = 0; i < m->hinges; i++) {
        sf_real by = angle[i] - m->zero[i];
        sine[i] = sf_sin(by), cosine[i] = sf_cos(by);
    }
    for (int i = 0; i < m->bodies; i++) {
        sf_real *Ri = R + 9 * i, at[3] = {0, 0, 0}, speed[3] = {0, 0, 0}, turn[3] = {spin[0], spin[1], spin[2]};
        const sf_real *axes = level; /* so far */
        if (i > 0) {
            int from = m->parent[i];
            const sf_real *own = m->R_parent_body + 9 * i;
            axes = R + 9 * from;
            for (int k = 0; k < 3; k++) at[k] = p[3 * from + k], speed[k] = v[3 * from + k], turn[k] = w[3 * from + k];
            sf_reach(at, speed, axes, turn, 1, m->place + 3 * i);
            /* Most lie along their parent's. */
            if (!(own[0] == 1 && own[4] == 1 && own[1] == 0 && own[2] == 0 && own[5] == 0)) {
                sf_then(turned, axes, own);
                axes = turned;
            }
        }
        for (; hinge < m->hinges && m->hinge_body[hinge] == i; hinge++) {
            /* The anchor stays where it is; what turns about it is the frame. */
            const sf_real *anchor = m->anchor + 3 * hinge;
            int apart = sf_square(anchor) > 0;
            if (apart) sf_reach(at, speed, axes, turn, 1, anchor);
            sf_turn_on(Ri, axes, m->axis + 3 * hinge, a, sine[hinge], cosine[hinge]);
            axes = Ri;
            for (int k = 0; k < 3; k++) turn[k] += a[k] * rate[hinge];
            if (apart) sf_reach(at, speed, axes, turn, -1, anchor);
        }
        if (axes != Ri) sf_copy(Ri, axes, 9);
        for (int k = 0; k < 3; k++) p[3 * i + k] = at[k], v[3 * i + k] = speed[k], w[3 * i + k] = turn[k];
    }
    /* Apart from the tree, so that no body waits for another. */
    for (int i = 0; i < m->bodies; i++) {
        const sf_real *Ri = R + 9 * i;
        sf_real own = m->mass[i], at[3] = {p[3 * i], p[3 * i + 1], p[3 * i + 2]};
        sf_real speed[3] = {v[3 * i], v[3 * i + 1], v[3 * i + 2]};
        sf_reach(at, speed, Ri, w + 3 * i, 1, m->com + 3 * i);
        sf_turn_back(a, Ri, w + 3 * i);
        sf_turn(b, m->inertia + 9 * i, a);
        sf_turn(a, Ri, b);
        sf_cross(b, at, speed);
        mass += own;
        for (int k = 0; k < 3; k++) {
            moment[k] += own * at[k];
            linear[k] += own * speed[k];
            angular[k] += a[k] + own * b[k];
        }
    }
    for (int k = 0; k < 3; k++) row[SF_ROW_COM + k] = moment[k] / mass;
    for (int k = 0; speeds && k < 3; k++) speeds[k] = linear[k] / mass;
    sf_cross(b, row + SF_ROW_COM, linear);
    for (int k = 0; k < 3; k++) row[SF_ROW_MOMENTUM + k] = angular[k] - b[k];
    for (int site = 0; site < 3; site++) {
        int on = m->site_body[site];
        sf_turn(a, R + 9 * on, m->position_site + 3 * site);
        for (int k = 0; k < 3; k++) row[SF_ROW_IMU + 3 * site + k] = p[3 * on + k] + a[k];
        if (speeds) {
            sf_cross(b, w + 3 * on, a);
            for (int k = 0; k < 3; k++) {
                speeds[3 + 6 * site + k] = w[3 * on + k];
                speeds[6 + 6 * site + k] = v[3 * on + k] + b[k];
            }
        }
        sf_then(turned, R + 9 * on, m->R_body_site + 9 * site);
        for (int axis = 0; site > 0 && axis < 3; axis++)
            for (int k = 0; k < 3; k++)
                row[SF_ROW_AXES + 9 * (site - 1) + 3 * axis + k] = turned[3 * k + axis];
    }
}

/* ----------------------------------------------------------------------------------------------- odometry */

/* Odometry._upright: which way is up by the lower sole, or by both where they are level with each other. */
SF_API void sf_upright_by_soles(const sf_beliefs *s, const sf_real *row, sf_real *up) {
    const sf_real *left = row + SF_ROW_SOLES, *right = left + 3, *axes = row + SF_ROW_AXES;
    sf_real above = ((left[0] - right[0]) * s->up[0] + (left[1] - right[1]) * s->up[1] +
                     (left[2] - right[2]) * s->up[2]) /
                    SF_SOLE_HEIGHT;
    sf_real weight = (sf_real)0.5 * sf_clip(1 - above, 0, 2);
    for (int k = 0; k < 3; k++) up[k] = weight * axes[6 + k] + (1 - weight) * axes[15 + k];
}

/* Odometry.turn: take in one middle between packets, and return the rotation R from the torso's axes. */
SF_API void sf_odometry_turn(const sf_timing *t, sf_beliefs *s, const sf_real *spin, const sf_real *force,
                             const sf_real *row, sf_real *R) {
    sf_real period = (sf_real)t->period, by[3], up[3], pull[3], moved[3], first, share, along;
    s->count++;
    first = 1 / (sf_real)s->count;
    for (int k = 0; k < 3; k++) {
        by[k] = ((sf_real)0.5 * (spin[k] + s->spin[k]) - s->spin_bias[k]) * period;
        s->spin[k] = spin[k];
    }
    sf_upright_by_soles(s, row, up);
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

/* ------------------------------------------------------------------------------------------------ packets */

/* Where in a ring the row of a packet's number is, and that row. */
SF_API sf_whole sf_place(sf_whole number) {
    sf_whole at = number % SF_PACKETS;
    return at < 0 ? at + SF_PACKETS : at;
}
SF_API sf_real *sf_row(sf_beliefs *s, sf_whole number) { return s->ring + SF_ROW * sf_place(number); }

/* Posture: the robot at the middle between two packets, in the torso's axes, as sf_evaluate leaves it. */
typedef struct {
    sf_real local[SF_ROW_ACCELERATION], speeds[21], force[3], spin[3];
} sf_posture;

/* Beliefs._find_posture and _keep: fill the row at the middle between two packets. */
SF_API void sf_middle(const sf_model *m, const sf_timing *t, sf_beliefs *s, sf_real *row, const sf_real *angle,
                      const sf_real *accelerometer, const sf_real *gyroscope, sf_posture *found) {
    sf_real middle[SF_HINGES], rate[SF_HINGES], *force = found->force, *spin = found->spin, *local = found->local, R[9];
    for (int i = 0; i < m->hinges; i++) {
        middle[i] = (sf_real)0.5 * (s->angle[i] + angle[i]);
        rate[i] = (angle[i] - s->angle[i]) / (sf_real)t->period;
    }
    for (int k = 0; k < 3; k++) {
        force[k] = t->averaged ? accelerometer[k] : (sf_real)0.5 * (s->accelerometer[k] + accelerometer[k]);
        spin[k] = t->averaged ? gyroscope[k] : (sf_real)0.5 * (s->gyroscope[k] + gyroscope[k]);
    }
    sf_evaluate(m, middle, rate, spin, local, found->speeds);
    sf_odometry_turn(t, s, spin, force, local, R);
    for (int k = 0; k < 3; k++) local[SF_ROW_FORCE + k] = force[k] - s->force_bias[k];
    for (int i = 0; i < SF_ROW_ACCELERATION; i += 3) sf_turn(row + i, R, local + i);
    sf_copy(row + SF_ROW_ACCELEROMETER, force, 3);
    sf_copy(row + SF_ROW_GYROSCOPE, spin, 3);
}

/* Beliefs._differentiate: fill in the rates one middle before a packet's, from its neighbours. */
SF_API void sf_differentiate(const sf_timing *t, sf_beliefs *s, sf_whole number) {
    const sf_real *before = sf_row(s, number - 2), *after = sf_row(s, number);
    sf_real *row = sf_row(s, number - 1), period = (sf_real)t->period;
    for (int k = 0; k < 3; k++) {
        int c = SF_ROW_COM + k, i = SF_ROW_IMU + k;
        sf_real bent = (before[c] + after[c] - 2 * row[c]) - (before[i] + after[i] - 2 * row[i]);
        row[SF_ROW_ACCELERATION + k] = row[SF_ROW_FORCE + k] + bent / (period * period);
        row[SF_ROW_RATE + k] = (after[SF_ROW_MOMENTUM + k] - before[SF_ROW_MOMENTUM + k]) / (2 * period);
    }
    row[SF_ROW_ACCELERATION + 2] -= t->gravity;
}

/* Whether all are numbers that a robot can have measured. */
SF_API int sf_measured(const sf_real *values, int count) {
    int good = 1;
    for (int i = 0; i < count; i++) good = good && sf_fabs(values[i]) <= SF_LARGEST_VALUE;
    return good;
}

/* Before any packet. */
SF_API void sf_beliefs_init(sf_beliefs *s) {
    memset(s, 0, sizeof *s);
    s->forward[0] = s->up[2] = 1;
}

/* Beliefs._combine: add a packet to those that become one; whether that is whole, with the means in s->sum. */
SF_API int sf_join(const sf_timing *t, sf_beliefs *s, sf_whole number, const sf_real *accelerometer,
                   const sf_real *gyroscope) {
    sf_whole part = number % t->joined;
    if (part == 0) {
        s->parts = 0;
        memset(s->sum, 0, sizeof s->sum);
    }
    if (part != s->parts) {
        s->parts = t->joined;
        return 0;
    }
    for (int k = 0; k < 3; k++) s->sum[k] += accelerometer[k], s->sum[3 + k] += gyroscope[k];
    if (++s->parts < t->joined) return 0;
    for (int k = 0; k < 6; k++) s->sum[k] /= (sf_real)t->joined;
    return 1;
}

/* Beliefs.join: whether a packet is sound, and the last of those that become one: of that what follows is then. */
SF_API int sf_sound(const sf_model *m, const sf_timing *t, sf_beliefs *s, sf_whole *number, const sf_real *angle,
                    const sf_real **accelerometer, const sf_real **gyroscope) {
    if (!sf_measured(angle, m->hinges) || !sf_measured(*accelerometer, 3) || !sf_measured(*gyroscope, 3)) return 0;
    if (t->joined == 1) return 1;
    if (!sf_join(t, s, *number, *accelerometer, *gyroscope)) return 0;
    *number /= t->joined, *accelerometer = s->sum, *gyroscope = s->sum + 3;
    return 1;
}

/* Beliefs.take: take in one joined packet; whether it follows the last one, so that a posture was found. */
SF_API int sf_take(const sf_model *m, const sf_timing *t, sf_beliefs *s, sf_whole number, double arrival,
                   const sf_real *angle, const sf_real *accelerometer, const sf_real *gyroscope, sf_posture *found) {
    double left = arrival - t->delay - (double)number * t->period;
    int first = s->seen == 0;
    s->seen++;
    s->clock += (left - s->clock) / ((double)s->seen < SF_CLOCK_MEMORY ? (double)s->seen : SF_CLOCK_MEMORY);
    if (!first && number == s->number + 1) {
        s->run++;
        sf_middle(m, t, s, sf_row(s, number), angle, accelerometer, gyroscope, found);
        if (s->run >= 3) sf_differentiate(t, s, number);
    } else s->run = 0;
    s->number = number;
    sf_copy(s->angle, angle, m->hinges);
    sf_copy(s->accelerometer, accelerometer, 3);
    sf_copy(s->gyroscope, gyroscope, 3);
    return s->run > 0;
}

/* Beliefs.update: take in one packet. One with a value that is not finite, or beyond 1e6, is a lost one.

   number: of the packet; those that get lost or come twice leave a gap. arrival: on the host's clock in s.
   angle: of the hinges in rad. accelerometer, gyroscope: in the torso's axes, m/s^2 and rad/s. */
SF_API void sf_beliefs_packet(const sf_model *m, const sf_timing *t, sf_beliefs *s, sf_whole number,
                              double arrival, const sf_real *angle, const sf_real *accelerometer,
                              const sf_real *gyroscope) {
    sf_posture found;
    if (sf_sound(m, t, s, &number, angle, &accelerometer, &gyroscope))
        sf_take(m, t, s, number, arrival, angle, accelerometer, gyroscope, &found);
}

/* ---------------------------------------------------------------------------------------------- moments */

/* All NaN, and no foot in stance or swing. */
SF_API void sf_nothing(sf_belief *out) {
    sf_reference *r = &out->reference;
    for (int i = 0; i < 3; i++)
        r->com[i] = r->com_acceleration[i] = r->angular_momentum_rate[i] = out->accelerometer[i] =
            out->gyroscope[i] = (sf_real)NAN;
    for (int i = 0; i < 3 * SF_FEET; i++) r->position_sole[i] = (sf_real)NAN;
    for (int i = 0; i < 9 * SF_FEET; i++) r->R_level_sole[i] = (sf_real)NAN;
    r->momentum = 0;
    memset(r->stance, 0, sizeof r->stance);
    memset(r->swing, 0, sizeof r->swing);
    out->known = 0;
}

/* Beliefs.interpolate: what a ring of rows, each `width` numbers, holds at a moment; from row `low` to `high`. */
SF_API void sf_interpolate(const sf_timing *t, const sf_beliefs *s, const sf_real *ring, int width, double time,
                           sf_whole low, sf_whole high, sf_real *out) {
    sf_whole at;
    double index = (time - s->clock) / t->period + 0.5;
    if (!(index > (double)low)) index = (double)low;
    if (!(index < (double)high)) index = (double)high;
    at = (sf_whole)floor(index);
    if (at > high - 1) at = high - 1;
    if (high <= low) at = low;
    const sf_real *row = ring + width * sf_place(at), *next = ring + width * sf_place(at + 1);
    sf_real part = (sf_real)(index - (double)at);
    for (int i = 0; i < width; i++) out[i] = row[i] + part * (next[i] - row[i]);
}

/* Rows that there may be in a ring. */
SF_API sf_whole sf_rows_kept(const sf_beliefs *s) { return s->run < SF_PACKETS - 1 ? s->run : SF_PACKETS - 1; }

/* Put what is believed into a reference: the two rates, or velocity and momentum; soles (2, 3), and both soles' axes one
   after another, which are the columns of their rotations. */
SF_API void sf_put_reference(sf_reference *r, const sf_real *com, const sf_real *linear, const sf_real *angular,
                             const sf_real *soles, const sf_real *axes) {
    sf_copy(r->com, com, 3);
    sf_copy(r->com_acceleration, linear, 3);
    sf_copy(r->angular_momentum_rate, angular, 3);
    sf_copy(r->position_sole, soles, 6);
    for (int foot = 0; foot < 2; foot++)
        for (int axis = 0; axis < 3; axis++)
            for (int k = 0; k < 3; k++) r->R_level_sole[9 * foot + 3 * k + axis] = axes[9 * foot + 3 * axis + k];
}

/* Beliefs.reference: what the robot believed to do at a moment, in s of the host's clock. Contacts are left open. */
SF_API void sf_beliefs_reference(const sf_timing *t, sf_beliefs *s, double time, sf_belief *out) {
    sf_real rows[SF_ROW], level[SF_ROW_ACCELEROMETER], x, y, by, middle[2], low;
    const sf_real *left = rows + SF_ROW_SOLES, *right = left + 3;
    sf_reference *r = &out->reference;
    sf_nothing(out);
    if (s->run < 3) return;
    sf_interpolate(t, s, s->ring, SF_ROW, time, s->number - sf_rows_kept(s) + 2, s->number - 1, rows);
    x = rows[SF_ROW_AXES] + rows[SF_ROW_AXES + 9];
    y = rows[SF_ROW_AXES + 1] + rows[SF_ROW_AXES + 10];
    by = 1 / sf_sqrt(x * x + y * y);
    x *= by, y *= by;
    middle[0] = (sf_real)0.5 * (left[0] + right[0]), middle[1] = (sf_real)0.5 * (left[1] + right[1]);
    low = sf_min(left[2], right[2]);
    for (int i = 0; i < SF_ROW_ACCELEROMETER; i += 3) {
        int place = i < SF_ROW_AXES;
        level[i] = x * rows[i] + y * rows[i + 1] - (place ? x * middle[0] + y * middle[1] : 0);
        level[i + 1] = x * rows[i + 1] - y * rows[i] - (place ? x * middle[1] - y * middle[0] : 0);
        level[i + 2] = rows[i + 2] - (place ? low : 0);
    }
    sf_put_reference(r, level + SF_ROW_COM, level + SF_ROW_ACCELERATION, level + SF_ROW_RATE, level + SF_ROW_SOLES,
                     level + SF_ROW_AXES);
    sf_copy(out->accelerometer, rows + SF_ROW_ACCELEROMETER, 3);
    sf_copy(out->gyroscope, rows + SF_ROW_GYROSCOPE, 3);
    out->known = r->com[0] == r->com[0];
}

/* Beliefs.soles: where the soles are at a moment later than the newest packet, at their last velocities.

   soles: of the left and the right one its place x, y in m and its heading, in the level frame. */
SF_API void sf_beliefs_soles(const sf_timing *t, sf_beliefs *s, double time, sf_real soles[8]) {
    sf_real place[4], axis[4], x, y, by, dx, dy;
    for (int i = 0; i < 8; i++) soles[i] = i % 4 == 2;
    if (s->seen == 0 || s->run < 1 + SF_SLOPE) return;
    const sf_real *newest = sf_row(s, s->number), *before = sf_row(s, s->number - SF_SLOPE);
    double steps = (time - (s->clock + ((double)s->number - 0.5) * t->period)) / t->period;
    sf_real ahead = (sf_real)((steps < SF_FURTHEST ? steps > 0 ? steps : 0 : SF_FURTHEST) / SF_SLOPE);
    for (int foot = 0; foot < 2; foot++)
        for (int k = 0; k < 2; k++) {
            int p = SF_ROW_SOLES + 3 * foot + k, a = SF_ROW_AXES + 9 * foot + k;
            place[2 * foot + k] = newest[p] + ahead * (newest[p] - before[p]);
            axis[2 * foot + k] = newest[a] + ahead * (newest[a] - before[a]);
        }
    x = axis[0] + axis[2], y = axis[1] + axis[3];
    by = 1 / sf_sqrt(x * x + y * y);
    x *= by, y *= by;
    dx = (sf_real)0.5 * (place[0] - place[2]), dy = (sf_real)0.5 * (place[1] - place[3]);
    soles[0] = x * dx + y * dy, soles[1] = x * dy - y * dx;
    soles[4] = -soles[0], soles[5] = -soles[1];
    for (int foot = 0; foot < 2; foot++) {
        soles[4 * foot + 2] = x * axis[2 * foot] + y * axis[2 * foot + 1];
        soles[4 * foot + 3] = x * axis[2 * foot + 1] - y * axis[2 * foot];
    }
}

/* ----------------------------------------------------------------------------------------------- contacts */

/* Plan.at: take in what is planned now, left and right stance and left and right swing, and find what surely
   held `lag` samples ago. */
SF_API void sf_plan_at(const sf_timing *t, sf_beliefs *s, const unsigned char *planned, unsigned char *sure) {
    sf_whole *newest = s->planned + 4 * (t->window - 1);
    memmove(s->planned, s->planned + 4, (size_t)(4 * (t->window - 1)) * sizeof(sf_whole));
    for (int i = 0; i < 4; i++) {
        /* With a window of one the last run is still in its place. */
        sf_whole run = t->window > 1 ? newest[i - 4] : newest[i];
        newest[i] = planned[i] ? run + 1 : 0;
    }
    for (int i = 0; i < 4; i++) sure[i] = s->planned[i] >= t->needed;
}

/* Kinematics.at: which feet surely stood, or surely swung, by where they were. */
SF_API void sf_kinematics_at(const sf_timing *t, sf_beliefs *s, sf_belief *belief) {
    sf_reference *r = &belief->reference;
    sf_real low = sf_min(r->position_sole[2], r->position_sole[5]);
    int carried = sf_square(belief->accelerometer) > sf_power2(SF_FREE_FALL * t->gravity);
    for (int foot = 0; foot < 2; foot++) {
        sf_real height = r->position_sole[3 * foot + 2] - low;
        int down = carried && height < SF_DOWN && r->R_level_sole[9 * foot + 8] > SF_COS_FLAT;
        int up = carried && height > SF_LIFTED;
        s->found[foot] = down ? s->found[foot] + 1 : 0;
        s->found[2 + foot] = up ? s->found[2 + foot] + 1 : 0;
        r->stance[foot] = s->found[foot] > SF_CONTACT_MARGIN;
        r->swing[foot] = s->found[2 + foot] > SF_CONTACT_MARGIN;
    }
}

/* Upright.at: whether the robot stands, walks or runs, so that its feet carry all of it. */
SF_API int sf_upright_at(const sf_timing *t, sf_beliefs *s, sf_belief *belief) {
    const sf_reference *r = &belief->reference;
    sf_real share = t->dt / (t->dt + SF_LEAN_TIME), height;
    int upright;
    belief->fell = 0;
    if (r->com_acceleration[0] != r->com_acceleration[0]) return 1;
    for (int k = 0; k < 3; k++) s->lean[k] += share * (r->com_acceleration[k] - s->lean[k]);
    height = r->com[2] - sf_min(r->position_sole[2], r->position_sole[5]);
    s->highest = sf_max(s->highest, height);
    upright = sf_square(s->lean) < sf_power2(SF_LEANING * t->gravity) &&
              sf_square(s->force_bias) < SF_LARGEST_FORCE_BIAS * SF_LARGEST_FORCE_BIAS &&
              height > SF_LOWEST * s->highest;
    belief->fell = s->upright && !upright;
    s->upright = upright;
    return upright;
}

/* References.at: what the robot believes for one sample of its feet. It is NaN while it knows nothing, while
   it is not upright, and where `hold` asks for it.

   time: of the sample that the reference describes, in s of the host's clock. planned: left and right stance
   and left and right swing as planned now, or NULL for a robot that plans nothing: they are found then. */
SF_API void sf_beliefs_sample(const sf_timing *t, sf_beliefs *s, double time, const unsigned char *planned,
                              int hold, sf_belief *out) {
    unsigned char sure[4] = {0, 0, 0, 0};
    if (planned) sf_plan_at(t, s, planned, sure);
    out->fell = 0;
    if (hold) {
        sf_nothing(out);
        return;
    }
    sf_beliefs_reference(t, s, time, out);
    memcpy(out->reference.stance, sure, 2);
    memcpy(out->reference.swing, sure + 2, 2);
    if (!sf_upright_at(t, s, out)) sf_nothing(out);
    else if (!planned) sf_kinematics_at(t, s, out);
}

/* Whether a model and timing that come from elsewhere lie within the arrays. */
SF_API int sf_beliefs_fit(const sf_model *m, const sf_timing *t) {
    sf_real mass = 0;
    int fit = m->bodies >= 1 && m->bodies <= SF_BODIES && m->hinges >= 0 && m->hinges <= SF_HINGES &&
              t->window >= 1 && t->window <= SF_PLANNED && t->joined >= 1 && t->period > 0 && t->dt > 0 &&
              SF_PACKETS > SF_SLOPE;
    for (int i = 0; fit && i < m->bodies; i++) {
        fit = i == 0 || (m->parent[i] >= 0 && m->parent[i] < i);
        mass += m->mass[i];
    }
    for (int i = 0; fit && i < m->hinges; i++)
        fit = m->hinge_body[i] >= (i ? m->hinge_body[i - 1] : 0) && m->hinge_body[i] < m->bodies;
    for (int i = 0; fit && i < 3; i++) fit = m->site_body[i] >= 0 && m->site_body[i] < m->bodies;
    return fit && mass > 0;
}

#endif
