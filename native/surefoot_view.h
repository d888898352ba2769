/* What a policy is shown of calibrated feet, in C99: bounded, in single precision, and where a centre of
   pressure is not defined the last one that was. The specification is the Python in robot/foot_view.py.

       sf_view view;             bounds
       sf_held held;             zeros before an episode, but `cop_std`, which is the bound
       sf_beliefs_soles(&timing, &beliefs, now, soles);
       sf_view_show(&config, &view, &held, &estimate, soles, &shown);      once a sample */

#ifndef SUREFOOT_VIEW_H
#define SUREFOOT_VIEW_H

#include "surefoot_beliefs.h"

/* Bounds in N and in m, the robot's weight in N, whether its feet have no centres of pressure of their own, and whether
   they are round: forces act at their lowest points then. */
typedef struct {
    sf_real force_bound, cop_bound, weight;
    int flawed, rolls;
} sf_view;

/* The last centres of pressure that were defined: of all feet, its deviation, and that which is aligned; of each foot, and
   those which are aligned behind them. */
typedef struct {
    sf_real cop[2], cop_std[2], cop_aligned[2], cop_foot[4 * SF_FEET];
} sf_held;

/* The parts of an observation, by their names there. */
typedef struct {
    float foot_force[SF_CHANNELS], foot_load[SF_CHANNELS], cop_foot[2 * SF_FEET], cop[2], wrench[6 * SF_FEET];
    float vgrf[SF_FEET], foot_force_std[SF_CHANNELS], cop_std[2], cop_valid[1 + SF_FEET];
    float contact_probability[SF_FEET], undetermined[SF_CHANNELS];
    float foot_force_aligned[SF_CHANNELS], cop_foot_aligned[2 * SF_FEET], cop_aligned[2];
    int foot_flags[SF_CHANNELS];
} sf_shown;

SF_API sf_real sf_bounded(sf_real value, sf_real bound) { return sf_clip(value, -bound, bound); }

/* FootView.show. soles: of sf_beliefs_soles. */
SF_API void sf_view_show(const sf_config *c, const sf_view *v, sf_held *h, const sf_estimate *e,
                         const sf_real *soles, sf_shown *out) {
    sf_real load = 0, x = 0, y = 0;
    out->cop_valid[0] = e->cop_valid;
    for (int foot = 0; foot < c->feet; foot++) {
        const sf_real *sole = soles + 4 * foot, *wrench = e->wrench + 6 * foot;
        sf_real fz = v->rolls ? e->vgrf[foot] : wrench[SF_FZ], tx = v->rolls ? 0 : wrench[SF_MX];
        sf_real ty = v->rolls ? 0 : wrench[SF_MY];
        out->cop_valid[1 + foot] = e->cop_foot_valid[foot] && !v->flawed;
        for (int k = 2 * foot; out->cop_valid[1 + foot] && k < 2 * foot + 2; k++)
            h->cop_foot[k] = sf_bounded(e->cop_foot[k], v->cop_bound);
        for (int k = 2 * foot; !v->flawed && k < 2 * foot + 2; k++)
            if (sf_finite(e->cop_foot_aligned[k]))
                h->cop_foot[2 * c->feet + k] = sf_bounded(e->cop_foot_aligned[k], v->cop_bound);
        load += fz;
        x += sole[0] * fz - sole[2] * ty - sole[3] * tx;
        y += sole[1] * fz - sole[3] * ty + sole[2] * tx;
        for (int k = 6 * foot; k < 6 * foot + 6; k++)
            out->wrench[k] = (float)sf_bounded(e->wrench[k], v->force_bound);
        out->vgrf[foot] = (float)sf_bounded(e->vgrf[foot], v->force_bound);
        out->contact_probability[foot] = (float)e->contact_probability[foot];
    }
    if (out->cop_valid[0]) {
        sf_real measured[2] = {x / load, y / load};
        for (int k = 0; k < 2; k++) {
            /* the estimate has the same differences, in level axes that head nearly the same way */
            sf_real aligned = measured[k] + (e->cop_aligned[k] - e->cop_measured[k]);
            h->cop[k] = sf_bounded(measured[k] + (e->cop[k] - e->cop_measured[k]), v->cop_bound);
            if (sf_finite(aligned)) h->cop_aligned[k] = sf_bounded(aligned, v->cop_bound);
        }
        for (int k = 0; k < 2; k++)
            h->cop_std[k] = sf_min(sf_sqrt(sf_max(e->cop_covariance[3 * k], 0)), v->cop_bound);
    }
    for (int k = 0; k < 2 * c->feet; k++) {
        out->cop_foot[k] = (float)h->cop_foot[k];
        out->cop_foot_aligned[k] = (float)h->cop_foot[2 * c->feet + k];
    }
    for (int k = 0; k < 2; k++) {
        out->cop[k] = (float)h->cop[k];
        out->cop_std[k] = (float)h->cop_std[k];
        out->cop_aligned[k] = (float)h->cop_aligned[k];
    }
    for (int i = 0; i < c->channels; i++) {
        out->foot_force[i] = (float)sf_bounded(e->force[i], v->force_bound);
        out->foot_force_aligned[i] = (float)sf_bounded(e->force_aligned[i], v->force_bound);
        out->foot_load[i] = (float)(sf_bounded(e->force[i], v->force_bound) / v->weight);
        out->foot_force_std[i] = (float)sf_bounded(e->force_std[i], v->force_bound);
        out->undetermined[i] = (float)e->undetermined[i];
        out->foot_flags[i] = (int)e->flags[i];
    }
}

#endif
