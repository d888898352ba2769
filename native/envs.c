/* The truth and the observation of robots as a shared library, with a table of where their records' fields lie. */

#include "surefoot_observation.h"

#include "library.h"

typedef double sf_real;

/* Results of many robots lie array after array, robots in front of each; these are the places of the arrays in bytes. */
typedef struct {
    size_t row, vgrf, cop_world, cop, cop_foot, com, wrench_sole, wrench_ankle, cop_valid;
} sf_truth_room;
typedef struct {
    size_t state, cop_foot, cop, cop_valid, wrench, held, seen;
} sf_observation_room;

static const place places[] = {
    WHOLE_OF(foot_places), WHOLE_OF(places), WHOLE_OF(planned), WHOLE_OF(truth_room), WHOLE_OF(observation_room),
    FIELDS(foot_places, "word", ankle, contact, position_sole, axes_sole, flat),
    FIELDS(foot_places, "real", up),
    FIELDS(foot_places, "int", feet, com, rows, columns),
    FIELDS(places, "word", feet, joint_dofs),
    FIELDS(places, "real", cop_bound),
    FIELDS(places, "int", axes_torso, position_torso, gyroscope, com_velocity, joint_position, joints, speeds),
    FIELDS(planned, "real", com, com_velocity, cop, position_sole, yaw_sole, stance, phase),
    FIELDS(truth_room, "word", row, vgrf, cop_world, cop, cop_foot, com, wrench_sole, wrench_ankle, cop_valid),
    FIELDS(observation_room, "word", state, cop_foot, cop, cop_valid, wrench, held, seen),
};
LIBRARY_OF(places)

#define REALS(base, field) (double *)(void *)((base) + room->field)
#define SINGLES(base, field) (float *)(void *)((base) + room->field)

/* The means of robots' control steps, of rows (N, S, columns), for those from *first on. */
EXPORTED void surefoot_mean_truth(const sf_foot_places *at, const sf_truth_room *room, const double *rows, char *to,
                                  const int *first, int count) {
    size_t feet = (size_t)at->feet, columns = (size_t)at->columns;
    for (size_t i = (size_t)*first, end = i + (size_t)count; i < end; i++) {
        sf_mean_truth one = {
            REALS(to, row) + i * columns,
            REALS(to, vgrf) + i * feet,
            REALS(to, cop_world) + i * 2,
            REALS(to, cop) + i * 2,
            REALS(to, cop_foot) + i * 2 * feet,
            REALS(to, com) + i * 3,
            REALS(to, wrench_sole) + i * 6 * feet,
            REALS(to, wrench_ankle) + i * 6 * feet,
            (unsigned char *)to + room->cop_valid + i * (1 + feet),
        };
        sf_find_mean_truth(at, rows + i * columns * (size_t)at->rows, &one);
    }
}

/* The observations of robots, of rows (N, S, columns), qvel (N, speeds) and held (N, 3, 2), for those from *first on. */
EXPORTED void surefoot_observe(const sf_places *at, const sf_observation_room *room, const double *rows,
                               const double *qvel, const sf_planned *plans, const double *held, char *to,
                               const int *first, int count) {
    size_t columns = (size_t)at->feet->columns, substeps = (size_t)at->feet->rows;
    for (size_t i = (size_t)*first, end = i + (size_t)count; i < end; i++) {
        sf_observation one = {
            SINGLES(to, state) + i * (2 * (size_t)at->joints + SF_STATE),
            SINGLES(to, cop_foot) + i * 4,
            SINGLES(to, cop) + i * 2,
            SINGLES(to, cop_valid) + i * 3,
            REALS(to, wrench) + i * 12,
            REALS(to, held) + i * 6,
            (sf_seen *)(void *)(to + room->seen) + i,
        };
        sf_observe(at, rows + ((i + 1) * substeps - 1) * columns, qvel + i * (size_t)at->speeds, plans + i, held + i * 6,
                   &one);
    }
}
