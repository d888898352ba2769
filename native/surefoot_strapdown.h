/* What one robot knows of its momentum, in C99: as surefoot_beliefs.h, for method "moment".

   The specification is the Python in robot/beliefs/momentum.py, whose module docstring derives it.

       sf_momentum_beliefs beliefs;         all that is remembered
       sf_momentum_beliefs_init(&beliefs);
       sf_momentum_packet(&model, &timing, &beliefs, number, arrival, angle, accelerometer, gyroscope);
       sf_momentum_sample(&timing, &beliefs, time, planned, hold, &belief);     once a sample of the feet */

#ifndef SUREFOOT_STRAPDOWN_H
#define SUREFOOT_STRAPDOWN_H

#include "surefoot_beliefs.h"

/* Places of the vectors of a row, as in momentum.py: com, soles, their axes, and from sf_moved_own on velocity and
   momentum. */
enum { SF_MOVED_COM = 0, SF_MOVED_SOLES = 3, SF_MOVED_OWN = 6 };
SF_API int sf_moved_axes(int feet) { return SF_MOVED_SOLES + 3 * feet; }
SF_API int sf_moved_own(int feet) { return SF_MOVED_SOLES + 12 * feet; }
#define SF_MOVED (SF_MOVED_SOLES + 12 * SF_FEET + SF_MOVED_OWN) /* the widest one */

/* MomentumBeliefs */
typedef struct {
    sf_beliefs beliefs;
    sf_real moved[SF_PACKETS * SF_MOVED]; /* as sf_beliefs.ring */
} sf_momentum_beliefs;

/* Before any packet. */
SF_API void sf_momentum_beliefs_init(sf_momentum_beliefs *s) {
    sf_beliefs_init(&s->beliefs);
}

/* MomentumBeliefs._keep: fill the row of a posture. */
SF_API void sf_keep_momentum(const sf_timing *t, sf_momentum_beliefs *s, const sf_posture *posture) {
    int F = t->feet, own = sf_moved_own(F);
    sf_real *row = s->moved + (own + SF_MOVED_OWN) * sf_place(s->beliefs.number), local[SF_MOVED];
    sf_copy(local + SF_MOVED_COM, posture->local + SF_ROW_COM, 3);
    sf_copy(local + SF_MOVED_SOLES, posture->local + SF_ROW_SOLES, 12 * F);
    for (int i = 0; i < 3; i++) local[own + i] = posture->speeds[i] - posture->speeds[6 + i];
    sf_copy(local + own + 3, posture->local + sf_row_own(F) + SF_OWN_MOMENTUM, 3);
    for (int i = 0; i < own + SF_MOVED_OWN; i += 3) sf_turn(row + i, posture->R, local + i);
    for (int i = 0; i < 3; i++) row[own + i] += posture->velocity[i];
    for (int i = 0; i < sf_moved_axes(F); i++) row[i] += s->beliefs.strapdown.place[i % 3];
}

/* MomentumBeliefs.update: take in one packet; arguments as of sf_beliefs_packet. */
SF_API void sf_momentum_packet(const sf_model *m, const sf_timing *t, sf_momentum_beliefs *s, sf_whole number,
                               double arrival, const sf_real *angle, const sf_real *accelerometer,
                               const sf_real *gyroscope) {
    sf_motion_packet packet;
    sf_posture posture;
    int step;
    if (!sf_packet_of(m, &packet, number, arrival, angle, accelerometer, gyroscope)) return;
    while ((step = sf_go_on(m, t, &s->beliefs, &packet, &posture)))
        if (step > 1) sf_keep_momentum(t, s, &posture);
}

/* MomentumBeliefs.momentum: what the robot believed of a moment, with the contacts that stand in `out`. */
SF_API void sf_momentum_reference(const sf_timing *t, const sf_momentum_beliefs *s, double time, sf_belief *out) {
    const sf_beliefs *beliefs = &s->beliefs;
    int own = sf_moved_own(t->feet);
    sf_reference *r = &out->reference;
    unsigned char found[2 * SF_FEET];
    sf_real rows[SF_MOVED];
    memcpy(found, r->stance, SF_FEET);
    memcpy(found + SF_FEET, r->swing, SF_FEET);
    sf_nothing(t, out);
    r->momentum = 1;
    /* A reading stands for the middle of its interval, a momentum for the end. */
    if (beliefs->run > 1 &&
        sf_interpolate(t, beliefs, s->moved, own + SF_MOVED_OWN, time + 0.5 * (double)t->dt,
                       beliefs->number - sf_rows_kept(beliefs) + 1, beliefs->number, rows)) {
        sf_put_reference(t, r, rows + SF_MOVED_COM, rows + own, rows + own + 3, rows + SF_MOVED_SOLES,
                         rows + sf_moved_axes(t->feet));
    }
    memcpy(r->stance, found, SF_FEET);
    memcpy(r->swing, found + SF_FEET, SF_FEET);
    out->known = r->com[0] == r->com[0];
}

/* MomentumBeliefs.sample: what the robot believes for one sample of its feet; arguments as of sf_beliefs_sample. */
SF_API void sf_momentum_sample(const sf_timing *t, sf_momentum_beliefs *s, double time, const unsigned char *planned,
                               int hold, sf_belief *out) {
    sf_beliefs_sample(t, &s->beliefs, time, planned, hold, out);
    if (out->known) {
        sf_momentum_reference(t, s, time, out);
        return;
    }
    sf_nothing(t, out);
    out->reference.momentum = 1;
}

#endif
