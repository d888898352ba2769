/* What one robot knows of its own motion without its feet's sensors, in C99: packets of joint angles and an
   IMU in, the sf_reference that sf_moment_step takes out.

   The specification is the Python in robot/beliefs/: references.py and contacts.py, whose module docstrings derive it; docs/native.md tells how to use this file. Nothing is allocated, nothing is
   global, and nothing is read or written but what is passed in.

       sf_model model;           the robot's bodies and hinges, written by surefoot.robot.beliefs.native
       sf_timing timing;         its packets, samples and feet
       sf_beliefs beliefs;       all that is remembered, a plain record that may be copied
       sf_beliefs_init(&beliefs);
       sf_beliefs_packet(&model, &timing, &beliefs, number, arrival, angle, accelerometer, gyroscope);
       sf_beliefs_sample(&timing, &beliefs, time, planned, hold, &belief);      once a sample of the feet
       sf_moment_step(&config, &moment, &state, &work, raw, &belief.reference, dt, &estimate);

   Moments are doubles whatever SF_SINGLE says: after an hour a float tells no milliseconds apart.

   Before it is included: SF_PACKETS and SF_PLANNED are the largest sizes; for what surefoot_odometry.h takes see
   there. */

#ifndef SUREFOOT_BELIEFS_H
#define SUREFOOT_BELIEFS_H

#include "surefoot_odometry.h"

#ifndef SF_PACKETS
#define SF_PACKETS 64 /* kept: as many as the lag spans, and 3 */
#endif
#ifndef SF_PLANNED
#define SF_PLANNED 64 /* samples for which a plan is kept: the lag less 4, and 1 */
#endif

/* Constants of the Python modules, by their names there. */
#define SF_SLOPE 3
#define SF_FURTHEST 8.0
#define SF_CLOCK_MEMORY 256.0
#define SF_LARGEST_VALUE ((sf_real)1e3)
#define SF_CONTACT_MARGIN 4
#define SF_LIFTED ((sf_real)0.014)
#define SF_DOWN ((sf_real)0.004)
#define SF_FLAT ((sf_real)0.03)
#define SF_COS_FLAT (1 - (sf_real)0.5 * SF_FLAT * SF_FLAT)
#define SF_LEANING ((sf_real)0.4) /* of gravity */
#define SF_LEAN_TIME ((sf_real)0.25)
#define SF_STEEPEST ((sf_real)0.4)
#define SF_LOWEST ((sf_real)0.7)

/* ------------------------------------------------------------------------------------------------ records */

/* One packet of telemetry. */
typedef struct {
    double arrival; /* on the host's clock in s */
    sf_whole number;
    sf_real angle[SF_HINGES], accelerometer[3], gyroscope[3]; /* rad; m/s^2 and rad/s in the torso's axes */
} sf_motion_packet;

/* All that is remembered: Beliefs, Strapdown, Plan, Kinematics and Upright side by side. */
typedef struct {
    sf_motion_packet newest;      /* the last packet as it came */
    sf_whole packet_count; /* and how many came */
    sf_real angle[SF_HINGES], accelerometer[3], gyroscope[3]; /* the last joined packet */
    sf_strapdown strapdown;
    sf_real lean[3], highest;
    double clock; /* time in s on the host's clock at which packet 0 left */
    sf_real sum[6]; /* of the IMU over the packets that are being joined */
    sf_whole number, seen, run, parts;
    sf_whole planned[SF_PLANNED * 2 * SF_FEET], found[2 * SF_FEET], upright; /* samples: stance of each foot, then swing */
    sf_real ring[SF_PACKETS * SF_ROW]; /* rows as wide as the robot needs, of which `run` tells which are any */
} sf_beliefs;

/* What the robot believes of one moment; NaN where it knows nothing. */
typedef struct {
    sf_reference reference;
    sf_real accelerometer[3], gyroscope[3]; /* as measured, IMU's axes: m/s^2, rad/s */
    sf_real ground[3];                      /* normal of the ground in the reference's axes */
    unsigned char known;                    /* whether the reference is of numbers */
    unsigned char fell; /* whether the robot was upright until now: time for sf_moment_retract */
} sf_belief;

/* ------------------------------------------------------------------------------------------------ packets */

/* Where in a ring the row of a packet's number is, and that row. */
SF_API sf_whole sf_place(sf_whole number) {
    sf_whole at = number % SF_PACKETS;
    return at < 0 ? at + SF_PACKETS : at;
}
SF_API sf_real *sf_row(const sf_timing *t, sf_beliefs *s, sf_whole number) {
    return s->ring + (sf_row_own(t->feet) + SF_OWN) * sf_place(number);
}

/* Beliefs._find_posture: find the posture at the middle between the last joined packet and a new one. */
SF_API void sf_middle(const sf_model *m, const sf_timing *t, sf_beliefs *s, const sf_real *angle,
                      const sf_real *accelerometer, const sf_real *gyroscope, sf_posture *found) {
    sf_real middle[SF_HINGES], rate[SF_HINGES], *force = found->force, *spin = found->spin;
    for (int i = 0; i < m->hinges; i++) {
        middle[i] = (sf_real)0.5 * (s->angle[i] + angle[i]);
        rate[i] = (angle[i] - s->angle[i]) / (sf_real)t->period;
    }
    for (int k = 0; k < 3; k++) {
        force[k] = t->averaged ? accelerometer[k] : (sf_real)0.5 * (s->accelerometer[k] + accelerometer[k]);
        spin[k] = t->averaged ? gyroscope[k] : (sf_real)0.5 * (s->gyroscope[k] + gyroscope[k]);
    }
    sf_evaluate(m, t->feet, middle, rate, spin, found->local, found->speeds);
    sf_advance(t, &s->strapdown, found);
}

/* Beliefs._keep: fill the row of a posture. */
SF_API void sf_keep(const sf_timing *t, sf_beliefs *s, sf_posture *found, sf_real *row) {
    const sf_strapdown *strapdown = &s->strapdown;
    int own = sf_row_own(t->feet);
    for (int k = 0; k < 3; k++) found->local[own + SF_OWN_FORCE + k] = found->force[k] - strapdown->force_bias[k];
    for (int i = 0; i < own + SF_OWN_ACCELERATION; i += 3) sf_turn(row + i, found->R, found->local + i);
    row[own + SF_OWN_FORCE + 2] -= strapdown->vertical_bias;
    sf_turn(row + own + SF_OWN_GROUND, found->R, strapdown->ground);
    sf_copy(row + own + SF_OWN_ACCELEROMETER, found->force, 3);
    sf_copy(row + own + SF_OWN_GYROSCOPE, found->spin, 3);
}

/* Beliefs._differentiate: fill in the rates one middle before a packet's, from its neighbours. */
SF_API void sf_differentiate(const sf_timing *t, sf_beliefs *s, sf_whole number) {
    int own = sf_row_own(t->feet), to = own + SF_OWN_ACCELERATION;
    const sf_real *before = sf_row(t, s, number - 2), *after = sf_row(t, s, number);
    sf_real *row = sf_row(t, s, number - 1), period = (sf_real)t->period;
    for (int k = 0; k < 3; k++) {
        int c = SF_ROW_COM + k, i = SF_ROW_IMU + k;
        sf_real bent = (before[c] + after[c] - 2 * row[c]) - (before[i] + after[i] - 2 * row[i]);
        row[to + k] = row[own + SF_OWN_FORCE + k] + bent / (period * period);
        row[own + SF_OWN_RATE + k] = (after[own + SF_OWN_MOMENTUM + k] - before[own + SF_OWN_MOMENTUM + k]) / (2 * period);
    }
    row[to + 2] -= t->gravity;
}

/* Whether all are numbers that a robot can have measured. */
SF_API int sf_measured(const sf_real *values, int count) {
    int good = 1;
    for (int i = 0; i < count; i++) good = good && sf_fabs(values[i]) <= SF_LARGEST_VALUE;
    return good;
}

/* Before any packet. */
SF_API void sf_beliefs_init(sf_beliefs *s) {
    memset(s, 0, (size_t)((char *)s->ring - (char *)s));
    sf_strapdown_init(&s->strapdown);
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

/* Make a packet; whether it is sound, with values that a robot can have measured. Arguments as of sf_beliefs_packet. */
SF_API int sf_packet_of(const sf_model *m, sf_motion_packet *packet, sf_whole number, double arrival, const sf_real *angle,
                        const sf_real *accelerometer, const sf_real *gyroscope) {
    packet->number = number, packet->arrival = arrival;
    sf_copy(packet->angle, angle, m->hinges);
    sf_copy(packet->accelerometer, accelerometer, 3);
    sf_copy(packet->gyroscope, gyroscope, 3);
    return sf_measured(angle, m->hinges) && sf_measured(accelerometer, 3) && sf_measured(gyroscope, 3);
}

/* Beliefs._fill: go on by one packet, a new one or one of those that were lost before it; 0 if it was the last one, or
   comes late or twice. */
SF_API int sf_fill(const sf_model *m, const sf_timing *t, sf_beliefs *s, const sf_motion_packet *packet) {
    sf_motion_packet *newest = &s->newest;
    sf_whole lost = packet->number - newest->number - 1;
    if (s->packet_count && lost < 0 && lost >= -(sf_whole)t->filled) return 0;
    if (s->packet_count && lost > 0 && lost <= t->filled) {
        sf_real left = (sf_real)(lost + 1);
        for (int i = 0; i < m->hinges; i++) newest->angle[i] += (packet->angle[i] - newest->angle[i]) / left;
        for (int k = 0; k < 3; k++) {
            newest->accelerometer[k] += (packet->accelerometer[k] - newest->accelerometer[k]) / left;
            newest->gyroscope[k] += (packet->gyroscope[k] - newest->gyroscope[k]) / left;
        }
        newest->arrival = packet->arrival - (double)lost * t->period / t->joined;
        newest->number++;
    } else *newest = *packet;
    s->packet_count++;
    return 1;
}

/* Beliefs.take: take in one joined packet; whether there is a posture since the last one and the attitude is known. */
SF_API int sf_take(const sf_model *m, const sf_timing *t, sf_beliefs *s, sf_whole number, double arrival,
                   const sf_real *angle, const sf_real *accelerometer, const sf_real *gyroscope, sf_posture *found) {
    double left = arrival - t->delay - (double)number * t->period;
    int first = s->seen == 0;
    s->seen++;
    s->clock += (left - s->clock) / ((double)s->seen < SF_CLOCK_MEMORY ? (double)s->seen : SF_CLOCK_MEMORY);
    if (first || number != s->number + 1) {
        s->run = 0;
        if (!first) sf_coast(t, &s->strapdown, (double)(number - s->number) * t->period);
    } else {
        sf_middle(m, t, s, angle, accelerometer, gyroscope, found);
        s->run = sf_attitude_known(t, &s->strapdown) ? s->run + 1 : 0;
        if (s->run) sf_keep(t, s, found, sf_row(t, s, number));
        if (s->run >= 3) sf_differentiate(t, s, number);
    }
    s->number = number;
    sf_copy(s->angle, angle, m->hinges);
    sf_copy(s->accelerometer, accelerometer, 3);
    sf_copy(s->gyroscope, gyroscope, 3);
    return s->run > 0;
}

/* Beliefs.join and take: go on towards a packet by one, and by those that were lost before it; 0 where that is reached,
   1, or 2 if a posture was found. */
SF_API int sf_go_on(const sf_model *m, const sf_timing *t, sf_beliefs *s, const sf_motion_packet *packet, sf_posture *found) {
    const sf_motion_packet *newest = &s->newest;
    const sf_real *force = newest->accelerometer, *spin = newest->gyroscope;
    if (!sf_fill(m, t, s, packet)) return 0;
    if (t->joined > 1) {
        if (!sf_join(t, s, newest->number, force, spin)) return 1;
        force = s->sum, spin = s->sum + 3;
    }
    return 1 + sf_take(m, t, s, newest->number / t->joined, newest->arrival, newest->angle, force, spin, found);
}

/* Beliefs.update: take in one packet. One with a value that is not finite, or beyond 1e3, is a lost one.

   number: of the packet; those that get lost or come twice leave a gap. arrival: on the host's clock in s.
   angle: of the hinges in rad. accelerometer, gyroscope: in the torso's axes, m/s^2 and rad/s. */
SF_API void sf_beliefs_packet(const sf_model *m, const sf_timing *t, sf_beliefs *s, sf_whole number,
                              double arrival, const sf_real *angle, const sf_real *accelerometer,
                              const sf_real *gyroscope) {
    sf_motion_packet packet;
    sf_posture found;
    if (sf_packet_of(m, &packet, number, arrival, angle, accelerometer, gyroscope))
        while (sf_go_on(m, t, s, &packet, &found)) continue;
}

/* ---------------------------------------------------------------------------------------------- moments */

/* All NaN, and no foot in stance or swing. */
SF_API void sf_nothing(const sf_timing *t, sf_belief *out) {
    sf_reference *r = &out->reference;
    for (int i = 0; i < 3; i++)
        r->com[i] = r->com_acceleration[i] = r->angular_momentum_rate[i] = out->accelerometer[i] =
            out->gyroscope[i] = out->ground[i] = (sf_real)NAN;
    for (int i = 0; i < 3 * t->feet; i++) r->position_sole[i] = (sf_real)NAN;
    for (int i = 0; i < 9 * t->feet; i++) r->R_level_sole[i] = (sf_real)NAN;
    r->momentum = 0;
    memset(r->stance, 0, sizeof r->stance);
    memset(r->swing, 0, sizeof r->swing);
    out->known = 0;
}

/* Beliefs.interpolate: what a ring of rows, each `width` numbers, holds at a moment; from row `low` to `high`. Returns
   whether the moment is within the longest gap that is filled in from these rows. */
SF_API int sf_interpolate(const sf_timing *t, const sf_beliefs *s, const sf_real *ring, int width, double time,
                           sf_whole low, sf_whole high, sf_real *out) {
    sf_whole at;
    double index = (time - s->clock) / t->period + 0.5, wanted = index;
    if (!(index > (double)low)) index = (double)low;
    if (!(index < (double)high)) index = (double)high;
    if (!(fabs(wanted - index) * (double)t->joined <= (double)t->filled)) return 0;
    at = (sf_whole)floor(index);
    if (at > high - 1) at = high - 1;
    if (high <= low) at = low;
    const sf_real *row = ring + width * sf_place(at), *next = ring + width * sf_place(at + 1);
    sf_real part = (sf_real)(index - (double)at);
    for (int i = 0; i < width; i++) out[i] = row[i] + part * (next[i] - row[i]);
    return 1;
}

/* Rows that there may be in a ring. */
SF_API sf_whole sf_rows_kept(const sf_beliefs *s) { return s->run < SF_PACKETS - 1 ? s->run : SF_PACKETS - 1; }

/* Put what is believed into a reference: the two rates, or velocity and momentum; soles (F, 3), and the soles' axes one
   after another, which are the columns of their rotations. */
SF_API void sf_put_reference(const sf_timing *t, sf_reference *r, const sf_real *com, const sf_real *linear, const sf_real *angular,
                             const sf_real *soles, const sf_real *axes) {
    sf_copy(r->com, com, 3);
    sf_copy(r->com_acceleration, linear, 3);
    sf_copy(r->angular_momentum_rate, angular, 3);
    sf_copy(r->position_sole, soles, 3 * t->feet);
    for (int foot = 0; foot < t->feet; foot++)
        for (int axis = 0; axis < 3; axis++)
            for (int k = 0; k < 3; k++) r->R_level_sole[9 * foot + 3 * k + axis] = axes[9 * foot + 3 * axis + k];
}

/* Beliefs.reference: what the robot believed to do at a moment, in s of the host's clock. Contacts are left open. */
SF_API void sf_beliefs_reference(const sf_timing *t, sf_beliefs *s, double time, sf_belief *out) {
    int F = t->feet, own = sf_row_own(F), ends = own + SF_OWN_ACCELEROMETER;
    sf_real rows[SF_ROW], level[SF_ROW], x = 0, y = 0, by, middle[2] = {0, 0}, low = 0;
    sf_reference *r = &out->reference;
    sf_nothing(t, out);
    if (s->run < 3) return;
    if (!sf_interpolate(t, s, s->ring, own + SF_OWN, time, s->number - sf_rows_kept(s) + 2, s->number - 1, rows)) return;
    for (int foot = 0; foot < F; foot++) {
        const sf_real *sole = rows + SF_ROW_SOLES + 3 * foot, *forward = rows + sf_row_axes(F) + 9 * foot;
        x += forward[0], y += forward[1];
        middle[0] += sole[0], middle[1] += sole[1];
        low = foot ? sf_min(low, sole[2]) : sole[2];
    }
    by = 1 / sf_sqrt(x * x + y * y);
    x *= by, y *= by;
    middle[0] /= (sf_real)F, middle[1] /= (sf_real)F;
    for (int i = 0; i < ends; i += 3) {
        int place = i < sf_row_axes(F);
        level[i] = x * rows[i] + y * rows[i + 1] - (place ? x * middle[0] + y * middle[1] : 0);
        level[i + 1] = x * rows[i + 1] - y * rows[i] - (place ? x * middle[1] - y * middle[0] : 0);
        level[i + 2] = rows[i + 2] - (place ? low : 0);
    }
    sf_put_reference(t, r, level + SF_ROW_COM, level + own + SF_OWN_ACCELERATION, level + own + SF_OWN_RATE,
                     level + SF_ROW_SOLES, level + sf_row_axes(F));
    sf_copy(out->accelerometer, rows + ends, 3);
    sf_copy(out->gyroscope, rows + own + SF_OWN_GYROSCOPE, 3);
    sf_copy(out->ground, level + own + SF_OWN_GROUND, 3);
    out->known = r->com[0] == r->com[0];
}

/* The lowest part of a foot: its number. up: how high each of the sole's axes points. */
SF_API int sf_lowest_part(const sf_timing *t, int foot, const sf_real up[3], sf_real *height) {
    int lowest = 0;
    for (int n = 0; n < t->points; n++) {
        const sf_real *corner = t->corners + 3 * (foot * t->points + n);
        sf_real own = sf_dot(up, corner, 3) - t->radius[foot * t->points + n];
        if (n && !(own < *height)) continue;
        lowest = n, *height = own;
    }
    return lowest;
}

/* Beliefs.soles: where the soles are at a moment later than the newest packet, at their last velocities.

   soles: of each one its place x, y in m and its heading, in the level frame, 4 F numbers. */
SF_API void sf_beliefs_soles(const sf_timing *t, sf_beliefs *s, double time, sf_real *soles) {
    int F = t->feet;
    sf_real place[SF_FEET * 2], axes[SF_FEET * 9], x = 0, y = 0, by;
    for (int i = 0; i < 4 * F; i++) soles[i] = i % 4 == 2;
    if (s->seen == 0 || s->run < 1 + SF_SLOPE) return;
    const sf_real *newest = sf_row(t, s, s->number), *before = sf_row(t, s, s->number - SF_SLOPE);
    double steps = (time - (s->clock + ((double)s->number - 0.5) * t->period)) / t->period;
    sf_real ahead = (sf_real)((steps < SF_FURTHEST ? steps > 0 ? steps : 0 : SF_FURTHEST) / SF_SLOPE);
    for (int foot = 0; foot < F; foot++) {
        int p = SF_ROW_SOLES + 3 * foot, a = sf_row_axes(F) + 9 * foot;
        for (int k = 0; k < 2; k++) place[2 * foot + k] = newest[p + k] + ahead * (newest[p + k] - before[p + k]);
        for (int k = 0; k < 9; k++) axes[9 * foot + k] = newest[a + k] + ahead * (newest[a + k] - before[a + k]);
        x += axes[9 * foot], y += axes[9 * foot + 1];
    }
    by = 1 / sf_sqrt(x * x + y * y);
    x *= by, y *= by;
    for (int foot = 0; foot < F; foot++) {
        const sf_real *own = axes + 9 * foot, *at = place + 2 * foot;
        sf_real dx = 0, dy = 0; /* from the middle of all */
        for (int other = 0; other < F; other++) dx += at[0] - place[2 * other], dy += at[1] - place[2 * other + 1];
        dx /= (sf_real)F, dy /= (sf_real)F;
        if (t->rolls) {
            const sf_real up[3] = {own[2], own[5], own[8]};
            sf_real height = 0, arm[3];
            sf_turn_back(arm, own, t->corners + 3 * (foot * t->points + sf_lowest_part(t, foot, up, &height)));
            dx += arm[0], dy += arm[1];
        }
        soles[4 * foot] = x * dx + y * dy, soles[4 * foot + 1] = x * dy - y * dx;
        soles[4 * foot + 2] = x * own[0] + y * own[1], soles[4 * foot + 3] = x * own[1] - y * own[0];
    }
}

/* ----------------------------------------------------------------------------------------------- contacts */

/* Plan.at: take in what is planned now, stance of each foot and then swing, and find what surely held `lag` samples
   ago. */
SF_API void sf_plan_at(const sf_timing *t, sf_beliefs *s, const unsigned char *planned, unsigned char *sure) {
    int wide = 2 * t->feet;
    sf_whole *newest = s->planned + wide * (t->window - 1);
    memmove(s->planned, s->planned + wide, (size_t)(wide * (t->window - 1)) * sizeof(sf_whole));
    for (int i = 0; i < wide; i++) {
        /* With a window of one the last run is still in its place. */
        sf_whole run = t->window > 1 ? newest[i - wide] : newest[i];
        newest[i] = planned[i] ? run + 1 : 0;
    }
    for (int i = 0; i < wide; i++) sure[i] = s->planned[i] >= t->needed;
}

/* Kinematics.at: which feet surely stood, or surely swung, by their heights along the normal of the ground. */
SF_API void sf_kinematics_at(const sf_timing *t, sf_beliefs *s, sf_belief *belief) {
    sf_reference *r = &belief->reference;
    sf_real height[SF_FEET], slope[SF_FEET], low = 0;
    int F = t->feet, carried = sf_square(belief->accelerometer) > sf_power2(SF_FREE_FALL * t->gravity);
    for (int foot = 0; foot < F; foot++) {
        sf_real below = 0, normal[3];
        /* A foot on its toes or on an edge bears load, wherever the middle of its sole is. */
        sf_turn_back(normal, r->R_level_sole + 9 * foot, belief->ground);
        sf_lowest_part(t, foot, normal, &below);
        slope[foot] = normal[2];
        height[foot] = sf_dot(r->position_sole + 3 * foot, belief->ground, 3) + below;
        low = foot ? sf_min(low, height[foot]) : height[foot];
    }
    sf_real size = sf_dot(r->com, belief->ground, 3) - low;
    for (int foot = 0; foot < F; foot++) {
        sf_real above = height[foot] - low, lifted = SF_LIFTED * size;
        for (int n = 0; n < t->points; n++) lifted = sf_max(lifted, t->radius[foot * t->points + n]);
        int flat = t->rolls || slope[foot] > SF_COS_FLAT;
        int down = carried && above < SF_DOWN * size && flat, up = carried && above > lifted;
        s->found[foot] = down ? s->found[foot] + 1 : 0;
        s->found[F + foot] = up ? s->found[F + foot] + 1 : 0;
        r->stance[foot] = s->found[foot] > SF_CONTACT_MARGIN;
        r->swing[foot] = s->found[F + foot] > SF_CONTACT_MARGIN;
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
    height = r->position_sole[2];
    for (int foot = 1; foot < t->feet; foot++) height = sf_min(height, r->position_sole[3 * foot + 2]);
    height = r->com[2] - height;
    s->highest = sf_max(s->highest, height);
    upright = sf_square(s->lean) < sf_power2(SF_LEANING * t->gravity) &&
              belief->ground[2] > sf_sqrt(1 - SF_STEEPEST * SF_STEEPEST) &&
              height > SF_LOWEST * s->highest;
    belief->fell = s->upright && !upright;
    s->upright = upright;
    return upright;
}

/* Beliefs.find: beliefs whose contacts are those of the plan, none without one; as sf_beliefs_sample. */
SF_API void sf_beliefs_find(const sf_timing *t, sf_beliefs *s, double time, const unsigned char *planned,
                              int hold, sf_belief *out) {
    unsigned char sure[2 * SF_FEET] = {0};
    if (planned) sf_plan_at(t, s, planned, sure);
    out->fell = 0;
    if (hold) {
        sf_nothing(t, out);
        return;
    }
    sf_beliefs_reference(t, s, time, out);
    memcpy(out->reference.stance, sure, (size_t)t->feet);
    memcpy(out->reference.swing, sure + t->feet, (size_t)t->feet);
    if (!sf_upright_at(t, s, out)) sf_nothing(t, out);
}

/* Beliefs.sample: what the robot believes for one sample of its feet. It is NaN while it knows nothing, while
   it is not upright, and where `hold` asks for it.

   time: of the sample that the reference describes, in s of the host's clock. planned: stance of each foot and
   then swing as planned now, or NULL for a robot that plans nothing: they are found then. */
SF_API void sf_beliefs_sample(const sf_timing *t, sf_beliefs *s, double time, const unsigned char *planned,
                              int hold, sf_belief *out) {
    sf_beliefs_find(t, s, time, planned, hold, out);
    if (!planned && out->known) sf_kinematics_at(t, s, out);
}

/* Whether a model and timing that come from elsewhere lie within the arrays. */
SF_API int sf_beliefs_fit(const sf_model *m, const sf_timing *t) {
    sf_real mass = 0;
    int fit = m->bodies >= 1 && m->bodies <= SF_BODIES && m->hinges >= 0 && m->hinges <= SF_HINGES &&
              t->window >= 1 && t->window <= SF_PLANNED && t->joined >= 1 && t->period > 0 && t->dt > 0 &&
              t->feet >= 1 && t->feet <= SF_FEET && t->points >= 1 && t->points <= SF_CORNERS &&
              SF_PACKETS > SF_SLOPE;
    for (int i = 0; fit && i < m->bodies; i++) {
        fit = i == 0 || (m->parent[i] >= 0 && m->parent[i] < i);
        mass += m->mass[i];
    }
    for (int i = 0; fit && i < m->hinges; i++)
        fit = m->hinge_body[i] >= (i ? m->hinge_body[i - 1] : 0) && m->hinge_body[i] < m->bodies;
    for (int i = 0; fit && i <= t->feet; i++) fit = m->site_body[i] >= 0 && m->site_body[i] < m->bodies;
    return fit && mass > 0;
}

#endif
