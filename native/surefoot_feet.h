/* All that is under one robot's feet, in C99: load cells, six-axis sensors or both, and what is broken about them.

   The specification is Instruments of robot/sensing/instruments.py and RobotSensors of sensors.py beside it; tests
   hold the two together. An episode begins with sf_feet_begin, and each control step after it is one sf_feet_step.
   Configs may be shared by robots; states and streams are each robot's own. */

#ifndef SUREFOOT_FEET_H
#define SUREFOOT_FEET_H

#include "surefoot_faults.h"
#include "surefoot_force_torque.h"
#include "surefoot_sensors.h"

#define SF_UNDER_FEET (SF_LOAD_CELLS + SF_AXES * SF_SIX_AXIS)

/* Where it all is; a config that is NULL says that there is none of it. The parts follow each other, cells first, and
   order[k] is where channel k stands in that row; NULL: there. Each part draws from a stream of its own. An episode's
   first reading is made after `first` s, and `more` follow it, dt apart, until none is of a load before. */
typedef struct {
    const sf_cells_config *cells_config;
    sf_cells *cells;
    const sf_force_torque_config *force_torque_config;
    sf_force_torque *force_torque;
    const sf_faults_config *faults_config;
    sf_faults *faults;
    sf_random *cells_stream, *force_torque_stream, *faults_stream;
    const int *order;
    double dt, first;
    int more;
} sf_feet;

/* Read them after dt: loads of the cells in N at the ends of equal substeps that fill it, a row each, and the wrenches
   in N and N m at its end, to counts, one a channel. */
SF_API void sf_feet_read(const sf_feet *f, const sf_real *load, int rows, const sf_real *wrench, sf_real dt,
                         sf_real *counts) {
    sf_real row[SF_UNDER_FEET];
    int cells = f->cells_config ? f->cells_config->channels : 0;
    int K = cells + (f->force_torque_config ? SF_AXES * f->force_torque_config->sensors : 0);
    if (f->cells_config) sf_cells_step(f->cells_config, f->cells, f->cells_stream, load, rows, dt, row);
    if (f->force_torque_config)
        sf_force_torque_step(f->force_torque_config, f->force_torque, f->force_torque_stream, wrench, dt, row + cells);
    for (int k = 0; k < K; k++) counts[k] = row[f->order ? f->order[k] : k];
    if (f->faults_config) sf_faults_step(f->faults_config, f->faults, f->faults_stream, dt, counts);
}

/* Read them after a control step; as sf_feet_read. */
SF_API void sf_feet_step(const sf_feet *f, const sf_real *load, int rows, const sf_real *wrench,
                         sf_real *counts) {
    sf_feet_read(f, load, rows, wrench, (sf_real)f->dt, counts);
}

/* Begin an episode under its first loads, with sensors that were drawn or kept; what the last of the readings leaves in
   counts is the episode's first. */
SF_API void sf_feet_begin(const sf_feet *f, const sf_real *load, int rows, const sf_real *wrench,
                          sf_real *counts) {
    if (f->cells_config) {
        const sf_real *last = load + (rows - 1) * sf_loads(f->cells_config);
        for (int i = 0; i < f->cells_config->channels; i++)
            f->cells->charge[i] =
                sf_felt(f->cells_config, f->cells, last, i) * (f->cells->period[i] - f->cells->due[i]);
    }
    sf_feet_read(f, load, rows, wrench, (sf_real)f->first, counts);
    for (int n = 0; n < f->more; n++) sf_feet_read(f, load, rows, wrench, (sf_real)f->dt, counts);
}

#endif
