/* The truth of a control step of one robot: means over its substeps of the loads of its feet, as ideal cells give them.

   The Python of surefoot.envs.instrumentation.means is the specification, and equal to the last bit. A row is a substep of
   sensor data. Forces are in N, moments in N m, places in m. */

#ifndef SUREFOOT_TRUTH_H
#define SUREFOOT_TRUTH_H

#include <math.h>

#define SF_CONTACT_FORCE 5.0 /* vertical force in N above which a centre of pressure is defined */

/* Where in a row feet are, of each the first of its numbers, as surefoot.envs.instrumentation.means.FootPlaces has it. */
typedef struct {
    const int *ankle;         /* force and torque, of the robot on the foot (6) */
    const int *contact;       /* force, torque and the place at which they act, in the world (9) */
    const int *position_sole; /* origin of the sole frame (3) */
    const int *axes_sole;     /* its axes one after another (9) */
    const int *flat;          /* whether it has an area */
    double up;                /* 1 for loads of the ground on the robot, -1 for those of the robot on the ground */
    int feet, com, rows, columns;
} sf_foot_places;

/* Results of one robot with F feet. */
typedef struct {
    double *row;                                   /* the mean row (columns) */
    double *vgrf, *cop_world, *cop, *cop_foot;     /* (F), (2), (2), (F, 2) */
    double *com, *wrench_sole, *wrench_ankle;      /* (3), (F, 6), (F, 6) */
    unsigned char *cop_valid;                      /* (1 + F), the common one first */
} sf_mean_truth;

/* Turns a vector of the world about the vertical into a frame with a heading in rad. */
static inline void sf_rotate_level(double x, double y, double heading, double *level) {
    double c = cos(heading), s = sin(heading);
    level[0] = c * x + s * y;
    level[1] = c * y - s * x;
}

/* The level frame of the soles: where its origin is, (x, y), and its heading in rad. */
static inline void sf_level(const sf_foot_places *at, const double *row, double *frame) {
    double x = 0, y = 0, along = 0, across = 0, share = 1.0 / at->feet;
    for (int foot = 0; foot < at->feet; foot++) {
        const double *sole = row + at->position_sole[foot], *axes = row + at->axes_sole[foot];
        x += sole[0], y += sole[1];
        along += axes[0], across += axes[1];
    }
    frame[0] = share * x, frame[1] = share * y, frame[2] = atan2(across, along);
}

/* The centre of pressure of a vertical load and its moments about x and y; 0, and returns 0, where there is none. */
static inline int sf_centre(double load, double moment_x, double moment_y, int flat, double *cop) {
    int enough = load > SF_CONTACT_FORCE && flat;
    cop[0] = enough ? -moment_y / load : 0;
    cop[1] = enough ? moment_x / load : 0;
    return enough;
}

static inline double sf_dot(const double *axis, double x, double y, double z) {
    return axis[0] * x + axis[1] * y + axis[2] * z;
}

/* The ground's wrench on one foot at and in its sole frame (6). */
static inline void sf_wrench_at_sole(const sf_foot_places *at, int foot, const double *row, double *wrench) {
    const double *felt = row + at->contact[foot], *sole = row + at->position_sole[foot];
    const double *axes = row + at->axes_sole[foot];
    double up = at->up, fx = up * felt[0], fy = up * felt[1], fz = up * felt[2];
    double rx = felt[6] - sole[0], ry = felt[7] - sole[1], rz = felt[8] - sole[2];
    double tx = up * felt[3] + ry * fz - rz * fy, ty = up * felt[4] + rz * fx - rx * fz;
    double tz = up * felt[5] + rx * fy - ry * fx;
    for (int i = 0; i < 3; i++) {
        wrench[i] = sf_dot(axes + 3 * i, fx, fy, fz);
        wrench[3 + i] = sf_dot(axes + 3 * i, tx, ty, tz);
    }
}

/* Adds up one foot's loads in all substeps: the wrench at and in the sole's frame (6), and the moments about the world's
   x and y at the height of the contacts (2), each as the contact sensor has its sign. */
static inline void sf_add_up(const sf_foot_places *at, int foot, const double *rows, double *sums) {
    for (int i = 0; i < 8; i++) sums[i] = 0;
    for (int k = 0; k < at->rows; k++, rows += at->columns) {
        const double *felt = rows + at->contact[foot], *sole = rows + at->position_sole[foot];
        const double *axes = rows + at->axes_sole[foot];
        double fx = felt[0], fy = felt[1], fz = felt[2], tx = felt[3], ty = felt[4], tz = felt[5];
        double rx = felt[6] - sole[0], ry = felt[7] - sole[1], rz = felt[8] - sole[2];
        double mx = tx + ry * fz - rz * fy, my = ty + rz * fx - rx * fz, mz = tz + rx * fy - ry * fx;
        sums[6] = sums[6] + tx + felt[7] * fz;
        sums[7] = sums[7] + ty - felt[6] * fz;
        for (int i = 0; i < 3; i++) {
            const double *axis = axes + 3 * i;
            sums[i] = sums[i] + axis[0] * fx + axis[1] * fy + axis[2] * fz;
            sums[3 + i] = sums[3 + i] + axis[0] * mx + axis[1] * my + axis[2] * mz;
        }
    }
}

static inline void sf_find_mean_truth(const sf_foot_places *at, const double *rows, const sf_mean_truth *to) {
    double share = 1.0 / at->rows, up = at->up * share, load = 0, moment_x = 0, moment_y = 0;
    double sums[8], frame[3], level[2];
    double *row = to->row;
    for (int i = 0; i < at->columns; i++) row[i] = rows[i];
    for (int k = 1; k < at->rows; k++)
        for (int i = 0; i < at->columns; i++) row[i] += rows[k * at->columns + i];
    for (int i = 0; i < at->columns; i++) row[i] *= share;
    for (int foot = 0; foot < at->feet; foot++) {
        double *wrench = to->wrench_sole + 6 * foot;
        sf_add_up(at, foot, rows, sums);
        for (int i = 0; i < 6; i++) {
            wrench[i] = up * sums[i];
            to->wrench_ankle[6 * foot + i] = -row[at->ankle[foot] + i];
        }
        moment_x = moment_x + up * sums[6];
        moment_y = moment_y + up * sums[7];
        to->vgrf[foot] = 0.0 + at->up * row[at->contact[foot] + 2];
        load = load + to->vgrf[foot];
        to->cop_valid[1 + foot] =
            (unsigned char)sf_centre(wrench[2], wrench[3], wrench[4], at->flat[foot], to->cop_foot + 2 * foot);
    }
    to->cop_valid[0] = (unsigned char)sf_centre(load, moment_x, moment_y, 1, to->cop_world);
    sf_level(at, row, frame);
    sf_rotate_level(to->cop_world[0] - frame[0], to->cop_world[1] - frame[1], frame[2], level);
    for (int i = 0; i < 2; i++) to->cop[i] = to->cop_valid[0] ? level[i] : 0.0;
    for (int i = 0; i < 3; i++) to->com[i] = row[at->com + i];
}

#endif
