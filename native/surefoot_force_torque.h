/* Six-axis sensors of one robot, one step a sample: wrenches in, counts out, in C99.

   The specification is sensors/devices/force_torque.py for sensors by their matrices of errors, and
   sensors/devices/strain_gauges.py for one sensor down to its gauges; tests hold them together. NaN is a number like
   others, and drawing sensors is Python's.

       sf_force_torque_config config;   constants, written by surefoot.sensors.devices.native_force_torque
       sf_force_torque sensors;         all that is remembered
       sf_force_torque_step(&config, &sensors, &stream, wrench, dt, counts);      once a sample

       sf_strain_gauges_config, sf_strain_gauges and sf_strain_gauges_step likewise

   Before it is included: SF_SIX_AXIS, SF_GAUGES and SF_GAUGE_PLAYS are the largest sizes, as are those of
   surefoot_stages.h. */

#ifndef SUREFOOT_FORCE_TORQUE_H
#define SUREFOOT_FORCE_TORQUE_H

#include "surefoot_stages.h"

#ifndef SF_SIX_AXIS
#define SF_SIX_AXIS 8 /* sensors of a robot */
#endif
#ifndef SF_GAUGES
#define SF_GAUGES 12 /* gauges of a sensor */
#endif
#ifndef SF_GAUGE_PLAYS
#define SF_GAUGE_PLAYS 12 /* play operators of their hysteresis */
#endif
#define SF_AXES 6
#define SF_CUBIC_PEAK 2.598076211353316 /* one over the largest value of u (1 - u^2) between 0 and 1 */

/* ------------------------------------------------------------------------ sensors by their matrices of errors */

typedef struct {
    int sensors;
    sf_real slope[SF_AXES * SF_SIX_AXIS], noise[SF_AXES * SF_SIX_AXIS];
    sf_real full_scale_ratio[SF_AXES * SF_AXES], scale_drift, offset_walk[SF_AXES];
    sf_wire_config wire;
} sf_force_torque_config;

typedef struct {
    sf_real error[SF_AXES * SF_AXES * SF_SIX_AXIS], offset[SF_AXES * SF_SIX_AXIS];
    sf_wire_state wire;
} sf_force_torque;

/* Whether a config that comes from elsewhere lies within the arrays. */
SF_API int sf_force_torque_fits(const sf_force_torque_config *c) {
    return c->sensors >= 1 && c->sensors <= SF_SIX_AXIS && sf_wire_fits(&c->wire, SF_AXES * c->sensors);
}

/* Read the sensors: six numbers each in N and N m, at and in their frames, to as many counts. */
SF_API void sf_force_torque_step(const sf_force_torque_config *c, sf_force_torque *s, sf_random *stream,
                                 const sf_real *wrench, sf_real dt, sf_real *counts) {
    int K = SF_AXES * c->sensors;
    sf_real drawn[3 * SF_AXES * SF_SIX_AXIS], root = (sf_real)sqrt(dt);
    sf_random_fill(stream, 1, 3 * K, drawn);
    for (int i = 0; i < K; i++) {
        int axis = i % SF_AXES;
        const sf_real *felt = wrench + i - axis, *ratio = c->full_scale_ratio + SF_AXES * axis;
        sf_real *error = s->error + SF_AXES * i, talk = 0;
        error[axis] += c->scale_drift * root * drawn[i];
        s->offset[i] += root * c->offset_walk[axis] * drawn[K + i];
        for (int j = 0; j < SF_AXES; j++) talk += error[j] * ratio[j] * felt[j];
        sf_real read = wrench[i] + talk + s->offset[i] + drawn[2 * K + i] * c->noise[i];
        counts[i] = sf_code(&c->wire, i, c->slope[i] * read);
    }
    sf_wire(&c->wire, K, &s->wire, stream, dt, counts);
}

/* ------------------------------------------------------------------------------ one sensor down to its gauges */

typedef struct {
    int channels, bends, plays, creeps, walks, noisy, converts;
    sf_real full_scale[SF_AXES], creep_shares[SF_CREEPS], creep_time_constants[SF_CREEPS];
    sf_real hysteresis, hysteresis_excess[SF_AXES], slack[SF_GAUGE_PLAYS];
    sf_real walk_map[SF_GAUGES * SF_GAUGES], noise_map[SF_GAUGES * SF_GAUGES];
    sf_real temperature_ramp, temperature_rise, lowest, highest;
} sf_strain_gauges_config;

/* Fields are those of the Python state, by their way through its parts. */
typedef struct {
    sf_real response[SF_GAUGES * SF_AXES], tempco[2 * SF_GAUGES], offset[SF_GAUGES], temperature;
    sf_real creep_yielded[SF_CREEPS * SF_AXES], hysteresis_plays[SF_GAUGE_PLAYS * SF_AXES];
    sf_real bend_cubic[SF_AXES], bend_cross[SF_AXES * SF_AXES * SF_AXES];
} sf_strain_gauges;

/* Whether a config that comes from elsewhere lies within the arrays. */
SF_API int sf_strain_gauges_fits(const sf_strain_gauges_config *c) {
    return c->channels >= SF_AXES && c->channels <= SF_GAUGES && c->plays >= 0 && c->plays <= SF_GAUGE_PLAYS &&
           c->creeps >= 0 && c->creeps <= SF_CREEPS;
}

/* Add the cubic errors of six axes and the products of two. */
SF_API void sf_coupled_nonlinearity(const sf_real *full_scale, const sf_real *cubic, const sf_real *cross,
                                    sf_real *load) {
    sf_real u[SF_AXES];
    for (int i = 0; i < SF_AXES; i++) u[i] = sf_limit(load[i] / full_scale[i], -1, 1);
    for (int i = 0; i < SF_AXES; i++) {
        sf_real products = 0;
        for (int j = 0; j < SF_AXES; j++)
            for (int k = 0; k < SF_AXES; k++) products += cross[(i * SF_AXES + j) * SF_AXES + k] * u[k] * u[j];
        sf_real own = (sf_real)SF_CUBIC_PEAK * cubic[i] * (u[i] - u[i] * u[i] * u[i]);
        load[i] += full_scale[i] * (own + products);
    }
}

/* Add to each of K gauges what a matrix makes of as many standard normal numbers. */
SF_API void sf_gauge_noise(const sf_real *map, sf_real factor, int K, sf_random *stream, sf_real *value) {
    sf_real drawn[SF_GAUGES];
    sf_random_fill(stream, 1, K, drawn);
    for (int i = 0; i < K; i++) {
        sf_real sum = 0;
        for (int j = 0; j < K; j++) sum += drawn[j] * map[j * K + i];
        value[i] += factor * sum;
    }
}

/* Read the sensor: six numbers in N and N m, at and in its frame, to counts, one a gauge. */
SF_API void sf_strain_gauges_step(const sf_strain_gauges_config *c, sf_strain_gauges *s, sf_random *stream,
                                  const sf_real *wrench, sf_real dt, sf_real *counts) {
    int K = c->channels;
    sf_real load[SF_AXES], before = s->temperature;
    memcpy(load, wrench, sizeof load);
    if (c->bends) sf_coupled_nonlinearity(c->full_scale, s->bend_cubic, s->bend_cross, load);
    sf_creep(c->creep_shares, c->creep_time_constants, c->creeps, dt, SF_AXES, s->creep_yielded, load);
    for (int i = 0; i < SF_AXES && c->plays; i++)
        load[i] = sf_hysteresis(c->hysteresis, c->hysteresis_excess[i], c->full_scale[i], c->slack, c->plays,
                                s->hysteresis_plays + i, SF_AXES, load[i]);
    for (int i = 0; i < K; i++) {
        counts[i] = 0;
        for (int j = 0; j < SF_AXES; j++) counts[i] += s->response[SF_AXES * i + j] * load[j];
    }
    if (c->walks) sf_gauge_noise(c->walk_map, (sf_real)sqrt(dt), K, stream, s->offset);
    if (c->temperature_ramp > 0) s->temperature = sf_warmed(before, c->temperature_ramp, c->temperature_rise, dt);
    for (int i = 0; i < K; i++) {
        if (c->temperature_ramp > 0) {
            s->offset[i] += s->tempco[K + i] * (s->temperature - before);
            counts[i] *= 1 + s->tempco[i] * s->temperature;
        }
        counts[i] += s->offset[i];
    }
    if (c->noisy) sf_gauge_noise(c->noise_map, 1, K, stream, counts);
    for (int i = 0; i < K && c->converts; i++)
        counts[i] = (sf_real)rint(sf_limit(counts[i], c->lowest, c->highest));
}

#endif
