/* The robot as it believes itself to be, in C99: places and velocities of its bodies, centre of mass and angular
   momentum. The specification is the Python in robot/beliefs/nominal.py.

   Before it is included: SF_BODIES and SF_HINGES are the largest sizes; for what surefoot_robot.h takes see there. */

#ifndef SUREFOOT_NOMINAL_H
#define SUREFOOT_NOMINAL_H

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

/* Places of the first vectors of a row, see references.py; those behind the soles depend on the number of feet. */
enum { SF_ROW_COM = 0, SF_ROW_IMU = 3, SF_ROW_SOLES = 6 };
SF_API int sf_row_axes(int feet) { return SF_ROW_SOLES + 3 * feet; }
SF_API int sf_row_own(int feet) { return SF_ROW_SOLES + 12 * feet; } /* from where the robot's own angular momentum is */

/* The robot as it believes itself to be: a tree of bodies on hinges. Body 0 is the torso, which floats and
   carries the IMU with its axes along its own; parents stand before their children. Matrices by rows. */
typedef struct {
    int bodies, hinges;
    int parent[SF_BODIES];
    int hinge_body[SF_HINGES];    /* in the order of angles, which is that of bodies */
    int turned[SF_BODIES];        /* whether R_parent_body is another than 1: most are not read */
    int along[SF_HINGES];         /* the axis of the body that a hinge lies along, -1 for none of the three */
    int away[SF_HINGES];          /* whether its anchor is away from the body's origin */
    int site_body[1 + SF_FEET];   /* of the IMU and the soles, as many as sf_timing has feet */
    sf_real place[SF_BODIES * 3]; /* of a body's frame in its parent's, hinges at their zero, in m */
    sf_real R_parent_body[SF_BODIES * 9];
    sf_real anchor[SF_HINGES * 3], axis[SF_HINGES * 3], zero[SF_HINGES]; /* in the body's frame; angle, rad */
    sf_real mass[SF_BODIES], com[SF_BODIES * 3]; /* kg; m in the body's frame */
    sf_real inertia[SF_BODIES * 9]; /* about the com, in the body's axes, kg m^2 */
    sf_real position_site[(1 + SF_FEET) * 3], R_body_site[(1 + SF_FEET) * 9];
} sf_model;

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


SF_API sf_real sf_square(const sf_real *a) { return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]; }

/* ------------------------------------------------------------------------------------------------ nominal */

/* out = R turned on by an angle about a unit vector in its own axes (Rodrigues), and `a`, that vector in those around
   it; k: number of the axis that it lies along, as most do, or -1; out may be R. */
SF_API void sf_turn_on(sf_real *out, const sf_real *R, int k, const sf_real *axis, sf_real *a, sf_real sine, sf_real cosine) {
    int i = (k + 1) % 3, j = (k + 2) % 3;
    for (int r = 0; r < 3; r++, out += 3, R += 3) {
        sf_real x = R[0], y = R[1], z = R[2], u = R[i], v = R[j];
        if (k >= 0) {
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

   angle, rate: of the hinges in rad and rad/s. spin: angular velocity of the torso in its own axes. speeds:
   NominalModel.velocities, of the centre of mass and then angular velocity and velocity of each site. */
SF_API void sf_evaluate(const sf_model *m, int feet, const sf_real *angle, const sf_real *rate, const sf_real *spin,
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
            axes = R + 9 * from;
            for (int k = 0; k < 3; k++) at[k] = p[3 * from + k], speed[k] = v[3 * from + k], turn[k] = w[3 * from + k];
            sf_reach(at, speed, axes, turn, 1, m->place + 3 * i);
            if (m->turned[i]) {
                sf_then(turned, axes, m->R_parent_body + 9 * i);
                axes = turned;
            }
        }
        for (; hinge < m->hinges && m->hinge_body[hinge] == i; hinge++) {
            /* The anchor stays where it is; what turns about it is the frame. */
            const sf_real *anchor = m->anchor + 3 * hinge;
            if (m->away[hinge]) sf_reach(at, speed, axes, turn, 1, anchor);
            sf_turn_on(Ri, axes, m->along[hinge], m->axis + 3 * hinge, a, sine[hinge], cosine[hinge]);
            axes = Ri;
            for (int k = 0; k < 3; k++) turn[k] += a[k] * rate[hinge];
            if (m->away[hinge]) sf_reach(at, speed, axes, turn, -1, anchor);
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
    for (int k = 0; k < 3; k++) speeds[k] = linear[k] / mass;
    sf_cross(b, row + SF_ROW_COM, linear);
    for (int k = 0; k < 3; k++) row[sf_row_own(feet) + k] = angular[k] - b[k];
    for (int site = 0; site <= feet; site++) {
        int on = m->site_body[site];
        sf_turn(a, R + 9 * on, m->position_site + 3 * site);
        for (int k = 0; k < 3; k++) row[SF_ROW_IMU + 3 * site + k] = p[3 * on + k] + a[k];
        sf_cross(b, w + 3 * on, a);
        for (int k = 0; k < 3; k++) {
            speeds[3 + 6 * site + k] = w[3 * on + k];
            speeds[6 + 6 * site + k] = v[3 * on + k] + b[k];
        }
        sf_then(turned, R + 9 * on, m->R_body_site + 9 * site);
        for (int axis = 0; site > 0 && axis < 3; axis++)
            for (int k = 0; k < 3; k++)
                row[sf_row_axes(feet) + 9 * (site - 1) + 3 * axis + k] = turned[3 * k + axis];
    }
}

#endif
