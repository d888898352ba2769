// The constants of a robot, as `surefoot calibrate walk LOG --ros2` writes them: the library's records, field by field.

#pragma once

#include <algorithm>
#include <stdexcept>
#include <string>
#include <vector>

#include "surefoot_moment.h"
#include "surefoot_strapdown.h"
#include "library.h"  // where the fields of records lie

extern "C" const place *surefoot_places(void);
extern "C" size_t surefoot_places_count(void);

struct Robot {
    sf_config config{};
    sf_moment_config moment{};
    sf_model model{};
    sf_timing timing{};
};

// Fill a record of the library. lists: gives the numbers of a parameter; that of the field f is <prefix>.f.
template <class Lists> void read_record(const Lists &lists, const std::string &record, const std::string &prefix, void *to) {
    for (std::size_t k = 0; k < surefoot_places_count(); k++) {
        const place &at = surefoot_places()[k];
        const std::string field = at.field, map = prefix == "robot" ? field : "";
        if (record != at.record || field.empty()) continue;
        // The map stands where people look for it.
        const std::string name = map == "scale" ? "scale_N_per_count" : map == "offset" ? "offset_N" : prefix + "." + field;
        const std::vector<double> values = lists(name);
        const bool whole = at.kind == std::string("int");
        if (values.size() * (whole ? sizeof(int) : sizeof(double)) > at.size)
            throw std::runtime_error("The parameter '" + name + "' has more numbers than there is room for.");
        char *const first = static_cast<char *>(to) + at.offset;
        if (whole) std::copy(values.begin(), values.end(), reinterpret_cast<int *>(first));
        else std::copy(values.begin(), values.end(), reinterpret_cast<double *>(first));
    }
}

// Read a robot; throws std::runtime_error if a parameter is missing or does not fit.
template <class Lists> Robot read_robot(const Lists &lists) {
    Robot robot;
    read_record(lists, "config", "robot", &robot.config);
    read_record(lists, "moment_config", "moment", &robot.moment);
    read_record(lists, "model", "model", &robot.model);
    read_record(lists, "timing", "timing", &robot.timing);
    if (!sf_moment_fits(&robot.config, &robot.moment) || !sf_beliefs_fit(&robot.model, &robot.timing) ||
        robot.timing.feet != robot.config.feet)
        throw std::runtime_error("The parameters are of a robot that this node has no room for.");
    for (const char *name : {"scale_N_per_count", "offset_N"})
        if (lists(name).size() != std::size_t(robot.config.channels))
            throw std::runtime_error("The parameter '" + std::string(name) + "' needs " +
                                     std::to_string(robot.config.channels) + " numbers, one a channel.");
    return robot;
}
