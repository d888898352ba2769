/* Faults of single channels, one step a sample, in C99: what wires, chips and bridges do when they break.

   The specification is sensors/faults/channels.py; a test holds the two together. They act on counts of any device.

       sf_faults_config config;   constants, written by surefoot.sensors.devices.native_faults
       sf_faults faults;          all that is remembered
       sf_faults_step(&config, &faults, &stream, dt, counts);      once a sample, in place

   Before it is included: SF_FAULTS is the largest number of them. */

#ifndef SUREFOOT_FAULTS_H
#define SUREFOOT_FAULTS_H

#include "surefoot_stages.h"

#ifndef SF_FAULTS
#define SF_FAULTS 16
#endif
#define SF_FAULT_ROUNDING 1e-6

/* Kinds, as KINDS of the Python counts them. */
enum {
    SF_FAULT_DEAD, SF_FAULT_STUCK, SF_FAULT_SATURATED, SF_FAULT_SPIKING, SF_FAULT_DROPPED, SF_FAULT_SWAPPED,
    SF_FAULT_FLIPPED
};

/* `unloaded` is the code without a load, `size` that of a spike in counts; `lowest` and `highest` are where codes end,
   or what is saturated. A fault that never stops has an infinite `stop`. */
typedef struct {
    int channels, count, kind[SF_FAULTS], channel[SF_FAULTS], other[SF_FAULTS], rounds[SF_FAULTS];
    sf_real start[SF_FAULTS], stop[SF_FAULTS], unloaded[SF_FAULTS], lowest[SF_FAULTS], highest[SF_FAULTS];
    sf_real rate[SF_FAULTS], size[SF_FAULTS], probability[SF_FAULTS], burst[SF_FAULTS];
} sf_faults_config;

/* Fields are those of the Python state. */
typedef struct {
    double time[1]; /* in floats it would be seconds off after an hour */
    sf_real held[SF_FAULTS], lost[SF_FAULTS];
} sf_faults;

/* Whether a config that comes from elsewhere lies within the arrays. */
SF_API int sf_faults_fits(const sf_faults_config *c) {
    if (c->count < 0 || c->count > SF_FAULTS) return 0;
    for (int f = 0; f < c->count; f++)
        if (c->channel[f] < 0 || c->channel[f] >= c->channels || c->other[f] < 0 || c->other[f] >= c->channels)
            return 0;
    return 1;
}

/* Whether a reading is in a gap, by one step of a chain with two states. */
SF_API sf_real sf_gap(sf_real probability, sf_real burst, sf_real gap, sf_real drawn, sf_real dt) {
    if (burst == 0 || probability == 1) return (sf_real)(drawn < probability);
    sf_real leave = 1 - (sf_real)exp(-dt / burst), enter = leave * probability / (1 - probability);
    return (sf_real)(gap > (sf_real)0.5 ? drawn >= leave : drawn < (enter < 1 ? enter : 1));
}

/* What a spiking channel reads of its own code, by two uniform numbers. */
SF_API sf_real sf_spiked(const sf_faults_config *c, int f, sf_real code, const sf_real *drawn, sf_real dt) {
    if (!(drawn[0] < 1 - (sf_real)exp(-c->rate[f] * dt))) return code;
    sf_real jump = code * 0 + (drawn[1] < (sf_real)0.5 ? -1 : 1);
    sf_real off = sf_limit(code + jump * c->size[f], c->lowest[f], c->highest[f]);
    return c->rounds[f] ? (sf_real)rint(off) : off;
}

/* Turn the counts of all channels into what the host reads, dt after the reading before. */
SF_API void sf_faults_step(const sf_faults_config *c, sf_faults *s, sf_random *stream, sf_real dt,
                           sf_real *counts) {
    sf_real drawn[2 * SF_FAULTS], *own = drawn;
    double now = s->time[0] += (double)dt;
    int chances = 0;
    for (int f = 0; f < c->count; f++) chances += c->kind[f] == SF_FAULT_SPIKING || c->kind[f] == SF_FAULT_DROPPED;
    sf_random_fill(stream, 0, 2 * chances, drawn);
    for (int f = 0; f < c->count; f++) {
        int active = now >= (double)c->start[f] - SF_FAULT_ROUNDING && now < (double)c->stop[f] - SF_FAULT_ROUNDING;
        sf_real *read = counts + c->channel[f], code = *read, wrong = code, *held = s->held + f;
        if (!(active && !isnan(*held)) && !isnan(code)) *held = code;
        switch (c->kind[f]) {
        case SF_FAULT_DEAD: wrong = code * 0 + c->unloaded[f]; break;
        case SF_FAULT_STUCK: wrong = *held; break;
        case SF_FAULT_SATURATED: wrong = sf_limit(code, c->lowest[f], c->highest[f]); break;
        case SF_FAULT_SPIKING: wrong = sf_spiked(c, f, code, own, dt); break;
        case SF_FAULT_DROPPED:
            s->lost[f] = sf_gap(c->probability[f], c->burst[f], s->lost[f], *own, dt);
            if (s->lost[f] > (sf_real)0.5) wrong = (sf_real)NAN;
            break;
        case SF_FAULT_SWAPPED: wrong = counts[c->other[f]]; break;
        default: wrong = sf_limit(2 * c->unloaded[f] - code, c->lowest[f], c->highest[f]); /* flipped */
        }
        if (c->kind[f] == SF_FAULT_SPIKING || c->kind[f] == SF_FAULT_DROPPED) own += 2;
        if (!active) {
            s->lost[f] = 0;
            continue;
        }
        *read = wrong;
        if (c->kind[f] == SF_FAULT_SWAPPED) counts[c->other[f]] = code;
    }
}

#endif
