/* The moment filter in a robot's own loop: a line a sample on standard input, a line of answer on standard output.

   in:   counts (K, nan where none arrived), com (3), com_acceleration (3), angular_momentum_rate (3),
         position_sole (3 a foot), R_level_sole (9 a foot), stance and swing (0 or 1 a foot each), dt
   out:  forces in N (K), centre of pressure in m (2, nan where there is none), their standard deviations */

#include <stdio.h>
#include <stdlib.h>

#include "robot.h"

/* Read numbers from a line; returns where they end, or NULL if there are fewer. */
static char *numbers(char *line, sf_real *values, int n) {
    for (int i = 0; line && i < n; i++) {
        char *end;
        values[i] = (sf_real)strtod(line, &end);
        line = end == line ? NULL : end;
    }
    return line;
}

static void print(const sf_real *values, int n) {
    for (int i = 0; i < n; i++) printf("%.6f ", (double)values[i]);
}

int main(void) {
    static sf_moment_state state;
    static sf_moment_work work; /* of which nothing is remembered */
    static char line[4096];
    int K = robot.channels, F = robot.feet;
    sf_moment_init(&robot, &moment, &state, &work);
    while (fgets(line, sizeof line, stdin)) {
        sf_reference reference;
        sf_estimate estimate;
        sf_real counts[SF_CHANNELS], contacts[2 * SF_FEET], dt, cop_std[2];
        char *rest = numbers(line, counts, K);
        rest = numbers(rest, reference.com, 3);
        rest = numbers(rest, reference.com_acceleration, 3);
        rest = numbers(rest, reference.angular_momentum_rate, 3);
        rest = numbers(rest, reference.position_sole, 3 * F);
        rest = numbers(rest, reference.R_level_sole, 9 * F);
        rest = numbers(rest, contacts, 2 * F);
        if (!numbers(rest, &dt, 1)) {
            fprintf(stderr, "A line needs %d numbers, got: %s", K + 10 + 14 * F, line);
            return 1;
        }
        reference.momentum = 0; /* accelerations, which the filter adds up */
        for (int foot = 0; foot < F; foot++) {
            reference.stance[foot] = contacts[foot] != 0;
            reference.swing[foot] = contacts[F + foot] != 0;
        }
        sf_moment_step(&robot, &moment, &state, &work, counts, &reference, dt, &estimate);
        for (int axis = 0; axis < 2; axis++) cop_std[axis] = sf_sqrt(estimate.cop_covariance[3 * axis]);
        print(estimate.force, K);
        print(estimate.cop, 2);
        print(estimate.force_std, K);
        print(cop_std, 2);
        printf("\n");
    }
    return 0;
}
