// main.c in C++: the same lines in and out, and a class that a robot's own controller could hold.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>
#include <vector>

#include "robot.h"

class FootCalibrator {
public:
    FootCalibrator() { sf_moment_init(&robot, &moment, &state_, &work_); }

    sf_estimate update(const std::vector<sf_real> &counts, const sf_reference &reference, sf_real dt) {
        sf_estimate estimate;
        sf_moment_step(&robot, &moment, &state_, &work_, counts.data(), &reference, dt, &estimate);
        return estimate;
    }

private:
    sf_moment_state state_;  // a plain record: copies of the object go on by themselves
    sf_moment_work work_;    // of which nothing is remembered
};

static std::vector<sf_real> numbers(const std::string &line) {
    std::vector<sf_real> values;
    const char *at = line.c_str();
    for (char *end;; at = end) {
        const double value = std::strtod(at, &end);
        if (end == at) return values;
        values.push_back(static_cast<sf_real>(value));
    }
}

static void print(const sf_real *values, int n) {
    for (int i = 0; i < n; i++) std::printf("%.6f ", static_cast<double>(values[i]));
}

static const sf_real *take(const sf_real *from, sf_real *to, int n) {
    sf_copy(to, from, n);
    return from + n;
}

int main() {
    const int K = robot.channels, F = robot.feet, wanted = K + 10 + 14 * F;
    FootCalibrator feet;
    for (std::string line; std::getline(std::cin, line);) {
        const std::vector<sf_real> given = numbers(line);
        if (static_cast<int>(given.size()) < wanted) {
            std::cerr << "A line needs " << wanted << " numbers, got: " << line << "\n";
            return 1;
        }
        const std::vector<sf_real> counts(given.begin(), given.begin() + K);
        sf_reference reference{};
        const sf_real *rest = take(given.data() + K, reference.com, 3);
        rest = take(rest, reference.com_acceleration, 3);
        rest = take(rest, reference.angular_momentum_rate, 3);
        rest = take(rest, reference.position_sole, 3 * F);
        rest = take(rest, reference.R_level_sole, 9 * F);
        for (int foot = 0; foot < F; foot++) {
            reference.stance[foot] = rest[foot] != 0;
            reference.swing[foot] = rest[F + foot] != 0;
        }
        const sf_estimate estimate = feet.update(counts, reference, rest[2 * F]);
        const sf_real cop_std[] = {std::sqrt(estimate.cop_covariance[0]), std::sqrt(estimate.cop_covariance[3])};
        print(estimate.force, K);
        print(estimate.cop, 2);
        print(estimate.force_std, K);
        print(cop_std, 2);
        std::printf("\n");
    }
}
