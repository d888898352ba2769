/* The observation of one robot on two feet that follows a pattern, and what its reward is made of.

   The Python of surefoot.envs.observation is the specification, and equal to the last bit. */

#ifndef SUREFOOT_OBSERVATION_H
#define SUREFOOT_OBSERVATION_H

#include "surefoot_truth.h"

#define SF_SOLES 2
#define SF_STATE 15 /* numbers of the state after the joints */

/* Where in a row other parts are, of each the first of its numbers. */
typedef struct {
    const sf_foot_places *feet;
    const int *joint_dofs; /* where the joints' speeds are in qvel (joints) */
    double cop_bound;
    int axes_torso, position_torso, gyroscope, com_velocity, joint_position, joints, speeds;
} sf_places;

/* The parts of surefoot.envs.Command that are seen; x and y of places alone. */
typedef struct {
    double com[2], com_velocity[2], cop[2], position_sole[SF_SOLES][2], yaw_sole[SF_SOLES], stance[SF_SOLES], phase;
} sf_planned;

/* surefoot.envs.observation.Seen. */
typedef struct {
    double cop_valid, cop_error_world[2], cop_error_level[2], velocity_error_level[2], up_torso[3], height_torso;
} sf_seen;

/* Results of one robot. */
typedef struct {
    float *state, *cop_foot, *cop, *cop_valid; /* (2 joints + SF_STATE), (2, 2), (2), (3) */
    double *wrench, *held;                     /* (2, 6), (3, 2): the last valid centres of pressure */
    sf_seen *seen;
} sf_observation;

static inline double sf_between(double value, double lowest, double highest) {
    value = lowest > value ? lowest : value;
    return highest < value ? highest : value;
}

/* The ten commanded parts of the state, in the level frame of the commanded soles: its origin is midway between them,
   and its heading the mean of theirs. */
static inline void sf_command_state(const sf_planned *plan, double *parts) {
    const double(*soles)[2] = plan->position_sole;
    double left = plan->yaw_sole[0], right = plan->yaw_sole[1];
    double middle_x = 0.5 * (soles[0][0] + soles[1][0]), middle_y = 0.5 * (soles[0][1] + soles[1][1]);
    double heading = atan2(sin(left) + sin(right), cos(left) + cos(right));
    double angle = 2.0 * 3.14159265358979323846 * plan->phase;
    sf_rotate_level(plan->com[0] - middle_x, plan->com[1] - middle_y, heading, parts);
    sf_rotate_level(plan->com_velocity[0], plan->com_velocity[1], heading, parts + 2);
    sf_rotate_level(plan->cop[0] - middle_x, plan->cop[1] - middle_y, heading, parts + 4);
    parts[6] = plan->stance[0], parts[7] = plan->stance[1];
    parts[8] = sin(angle), parts[9] = cos(angle);
}

/* The true less the commanded, each in the level frame of its soles. */
static inline void sf_compare(const sf_places *at, const double *row, const sf_planned *plan, const double *frame,
                              const double *cop, const double *cop_level, sf_seen *seen) {
    const double(*soles)[2] = plan->position_sole;
    const double *velocity = row + at->com_velocity;
    double heading = 0.5 * (plan->yaw_sole[0] + plan->yaw_sole[1]), true_velocity[2], velocity_plan[2], cop_plan[2];
    sf_rotate_level(velocity[0], velocity[1], frame[2], true_velocity);
    sf_rotate_level(plan->com_velocity[0], plan->com_velocity[1], heading, velocity_plan);
    sf_rotate_level(plan->cop[0] - 0.5 * (soles[0][0] + soles[1][0]), plan->cop[1] - 0.5 * (soles[0][1] + soles[1][1]),
                    heading, cop_plan);
    for (int i = 0; i < 2; i++) {
        seen->cop_error_world[i] = cop[i] - plan->cop[i];
        seen->cop_error_level[i] = cop_level[i] - cop_plan[i];
        seen->velocity_error_level[i] = true_velocity[i] - velocity_plan[i];
    }
    for (int i = 0; i < 3; i++) seen->up_torso[i] = row[at->axes_torso + 3 * i + 2];
    seen->height_torso = row[at->position_torso + 2];
}

static inline void sf_show_state(const sf_places *at, const double *row, const double *qvel, const sf_planned *plan,
                                 float *state) {
    const double *axes = row + at->axes_torso;
    double parts[SF_STATE];
    int n = at->joints;
    for (int i = 0; i < n; i++) {
        state[i] = (float)row[at->joint_position + i];
        state[n + i] = (float)qvel[at->joint_dofs[i]];
    }
    parts[0] = atan2(axes[5], axes[8]);
    parts[1] = -asin(sf_between(axes[2], -1.0, 1.0));
    for (int i = 0; i < 3; i++) parts[2 + i] = row[at->gyroscope + i];
    sf_command_state(plan, parts + 5);
    for (int i = 0; i < SF_STATE; i++) state[2 * n + i] = (float)parts[i];
}

/* Shows the last row of a control step, with qvel of that instant and the centres of pressure that were held before. */
static inline void sf_observe(const sf_places *at, const double *row, const double *qvel, const sf_planned *plan,
                              const double *held, const sf_observation *to) {
    double load = 0, moment_x = 0, moment_y = 0, frame[3], cop[SF_SOLES + 1][2], level[2];
    int valid[SF_SOLES + 1];
    for (int foot = 0; foot < SF_SOLES; foot++) {
        const double *felt = row + at->feet->contact[foot];
        double up = at->feet->up, fz = up * felt[2], *wrench = to->wrench + 6 * foot;
        sf_wrench_at_sole(at->feet, foot, row, wrench);
        load = load + fz;
        moment_x = moment_x + up * felt[3] + felt[7] * fz;
        moment_y = moment_y + up * felt[4] - felt[6] * fz;
        valid[1 + foot] = sf_centre(wrench[2], wrench[3], wrench[4], at->feet->flat[foot], cop[1 + foot]);
    }
    valid[0] = sf_centre(load, moment_x, moment_y, 1, cop[0]);
    sf_level(at->feet, row, frame);
    sf_rotate_level(cop[0][0] - frame[0], cop[0][1] - frame[1], frame[2], level);
    for (int k = 0; k <= SF_SOLES; k++) {
        const double *place = k ? cop[k] : level;
        float *shown = k ? to->cop_foot + 2 * (k - 1) : to->cop;
        for (int i = 0; i < 2; i++) {
            to->held[2 * k + i] = valid[k] ? place[i] : held[2 * k + i];
            shown[i] = (float)sf_between(to->held[2 * k + i], -at->cop_bound, at->cop_bound);
        }
        to->cop_valid[k] = (float)valid[k];
    }
    to->seen->cop_valid = valid[0];
    sf_compare(at, row, plan, frame, cop[0], level, to->seen);
    sf_show_state(at, row, qvel, plan, to->state);
}

#endif
