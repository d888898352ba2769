"""The example of a ROS 2 node, compiled against stand-ins for ROS: its numbers are those of Python."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from surefoot.calibration import OnlineSetup, Parameters
from surefoot.calibration.native import NATIVE, c_source
from surefoot.calibration.native.library import installed
from surefoot.calibration.online import online_method
from surefoot.experiments.logs.motion import ACCELEROMETER, GYROSCOPE
from surefoot.robot import Beliefs, TelemetryLayout
from surefoot.robot.beliefs.momentum import MomentumBeliefs
from surefoot.robot.beliefs.native import c_source as model_source
from surefoot.sensors.transport.link import Packet

NODE = Path(__file__).parents[2] / "examples" / "ros2" / "node.cpp"
SAMPLES, FROZEN = 560, 480

STAND_IN = r"""
#pragma once
#include <cstdio>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>
#define RCL_ROS_TIME 1
#define RCLCPP_WARN(logger, ...) (std::printf("warned "), std::printf(__VA_ARGS__), std::printf("\n"))
namespace std_msgs::msg {
struct Float64MultiArray { std::vector<double> data; };
struct Int32MultiArray { std::vector<int> data; };
}
namespace std_srvs::srv {
struct Trigger { struct Request {}; struct Response { bool success; std::string message; }; };
struct SetBool { struct Request { bool data; }; struct Response { bool success; std::string message; }; };
}
namespace rclcpp {
struct Duration { double s; double seconds() const { return s; } };
struct Time {
    long ns;
    Time(long s, long n, int) : ns(1000000000L * s + n) {}
    long nanoseconds() const { return ns; }
    Duration operator-(const Time &other) const { return {1e-9 * double(ns - other.ns)}; }
};
struct Header { Time stamp{0, 0, 0}; std::string frame_id; };
struct Vector { double x, y, z; };
}
namespace geometry_msgs::msg {
struct PointStamped { rclcpp::Header header; rclcpp::Vector point; };
struct WrenchStamped { rclcpp::Header header; struct { rclcpp::Vector force, torque; } wrench; };
}
namespace sensor_msgs::msg {
struct JointState { std::vector<std::string> name; std::vector<double> position; };
struct Imu { rclcpp::Vector linear_acceleration, angular_velocity; };
}
inline void show(double v) { std::printf(" %.17g", v); }
inline void show(const rclcpp::Vector &v) { show(v.x); show(v.y); show(v.z); }
inline void show(const std_msgs::msg::Float64MultiArray &m) { for (double v : m.data) show(v); }
inline void show(const std_msgs::msg::Int32MultiArray &m) { for (int v : m.data) show(v); }
inline void show(const geometry_msgs::msg::PointStamped &m) {
    std::printf(" %s", m.header.frame_id.c_str());
    show(m.point);
}
inline void show(const geometry_msgs::msg::WrenchStamped &m) {
    std::printf(" %s", m.header.frame_id.c_str());
    show(m.wrench.force);
    show(m.wrench.torque);
}
namespace rclcpp {
template <class M> struct Publisher {
    using SharedPtr = std::shared_ptr<Publisher>;
    std::string topic;
    void publish(const M &m) { std::printf("%s", topic.c_str()); show(m); std::printf("\n"); }
};
template <class M> struct Subscription { using SharedPtr = std::shared_ptr<Subscription>; };
inline std::map<std::string, std::function<void(const std::vector<double> &)>> callbacks;
inline std::map<std::string, std::vector<std::string>> given;
inline long clock_ns = 5000000000L;
inline void get(double &to, const std::vector<std::string> &from) { to = std::stod(from[0]); }
inline void get(std::string &to, const std::vector<std::string> &from) { to = from[0]; }
inline void get(std::vector<std::string> &to, const std::vector<std::string> &from) { to = from; }
inline void get(std::vector<double> &to, const std::vector<std::string> &from) {
    for (const std::string &one : from) to.push_back(std::stod(one));
}
inline void heard(const std::vector<double> &v, std_msgs::msg::Float64MultiArray &m) { m.data = v; }
inline void heard(const std::vector<double> &v, sensor_msgs::msg::JointState &m) {
    m.name = given["joints"];  // and one that the node does not know, before them
    m.name.insert(m.name.begin(), "other");
    m.position = v;
}
inline void heard(const std::vector<double> &v, sensor_msgs::msg::Imu &m) {
    m = {{v[0], v[1], v[2]}, {v[3], v[4], v[5]}};
}
inline void ask(const std::vector<double> &, std_srvs::srv::Trigger::Request &) {}
inline void ask(const std::vector<double> &v, std_srvs::srv::SetBool::Request &r) { r.data = v[0] > 0.5; }
template <class S> struct Service { using SharedPtr = std::shared_ptr<Service>; };
struct Node {
    explicit Node(const std::string &) {}
    template <class T> T declare_parameter(const std::string &name, const T &value) {
        if (!given.count(name)) return value;
        T found{};
        get(found, given[name]);
        return found;
    }
    template <class M> typename Publisher<M>::SharedPtr create_publisher(const std::string &topic, int) {
        return std::make_shared<Publisher<M>>(Publisher<M>{topic});
    }
    template <class M, class F>
    typename Subscription<M>::SharedPtr create_subscription(const std::string &topic, int, F f) {
        callbacks[topic] = [f](const std::vector<double> &v) { M m{}; heard(v, m); f(m); };
        return std::make_shared<Subscription<M>>();
    }
    template <class S, class F> typename Service<S>::SharedPtr create_service(const std::string &name, F f) {
        callbacks[name] = [f, name](const std::vector<double> &v) {
            auto asked = std::make_shared<typename S::Request>();
            auto told = std::make_shared<typename S::Response>();
            ask(v, *asked);
            f(asked, told);
            std::printf("%s %d %s\n", name.c_str(), told->success, told->message.c_str());
        };
        return std::make_shared<Service<S>>();
    }
    Time now() const { return Time(0, clock_ns, RCL_ROS_TIME); }
    int get_logger() const { return 0; }
};
inline void init(int, char **argv) {
    std::ifstream file(argv[1]);
    for (std::string line; std::getline(file, line);) {
        std::istringstream words(line);
        std::string name, word;
        words >> name;
        while (words >> word) given[name].push_back(word);
    }
}
inline void shutdown() {}
template <class N> void spin(const std::shared_ptr<N> &) {
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string topic, word;
        std::vector<double> values;
        words >> clock_ns >> topic;
        while (words >> word) values.push_back(std::stod(word));
        callbacks[topic](values);
    }
}
}
"""


def spoken(time_ns: int, topic: str, values: Any = ()) -> str:
    return " ".join([str(time_ns), topic, *map(repr, map(float, values))])


@pytest.mark.slow
@pytest.mark.skipif(not NODE.is_file(), reason="the examples are not part of the wheel")
@pytest.mark.skipif(shutil.which("c++") is None, reason="needs a C++ compiler")
@pytest.mark.skipif(installed() is None, reason="needs surefoot's library in C: python -m surefoot.native")
def test_the_node_publishes_what_python_finds(recorded_walk: Any, tmp_path: Path) -> None:
    """A walk, sent as joint states, IMU and counts; the map of the parameters is not that of robot.h."""
    log, facts, model = recorded_walk.log, recorded_walk.description, recorded_walk.model
    lag, age, joints = 5, float(facts["readings_age_s"]), model.joint_names
    initial = Parameters(log.nominal.scale, log.nominal.offset + 0.5)
    known: dict[str, Any] = {"layout": log.layout, "mass": log.mass, "lag": lag, "dt": log.dt}
    setup = OnlineSetup(initial=initial, **known)
    layout = TelemetryLayout(len(joints))
    link = facts["dt_s"], facts["delay_s"], facts["averaged"]
    corners = np.stack([foot.position_cell_sole for foot in log.layout.feet])
    beliefs = MomentumBeliefs(Beliefs(model, layout, *link, lag=lag, dt=log.dt), corners)
    for name in (
        "rclcpp/rclcpp.hpp",
        *(f"std_msgs/msg/{kind}.hpp" for kind in ("float64_multi_array", "int32_multi_array")),
        *(f"std_srvs/srv/{kind}.hpp" for kind in ("set_bool", "trigger")),
        *(f"sensor_msgs/msg/{kind}.hpp" for kind in ("joint_state", "imu")),
        *(f"geometry_msgs/msg/{kind}.hpp" for kind in ("point_stamped", "wrench_stamped")),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text('#pragma once\n#include "stand_in.hpp"\n')
    (tmp_path / "stand_in.hpp").write_text(STAND_IN)
    (tmp_path / "robot.h").write_text(c_source(OnlineSetup(initial=log.nominal, **known)))
    (tmp_path / "model.h").write_text(model_source(beliefs))
    told = {"scale_N_per_count": initial.scale, "offset_N": initial.offset, "joints": joints}
    told |= {"readings_age_s": [age], "save_to": [tmp_path / "saved.yaml"]}
    lines = [" ".join([name, *map(str, values)]) for name, values in told.items()]
    (tmp_path / "parameters").write_text("\n".join(lines))
    includes = (f"-I{tmp_path}", f"-I{NATIVE.sources.folder}")
    program = tmp_path / "node"
    strict = ("-std=c++17", "-O0", "-ffp-contract=off", "-Wall", "-Werror")
    subprocess.run(["c++", *strict, *includes, "-o", program, NODE], check=True)

    motion = recorded_walk.motion
    arrivals = np.rint(1e9 * motion["time_s"].to_numpy()).astype(int) + 10**9
    times = np.rint(1e9 * log.time).astype(int) + 10**9
    angle = motion[[f"joint_{name}_rad" for name in joints]].to_numpy()
    imu = motion[[*ACCELEROMETER, *GYROSCOPE]].to_numpy()
    stream = online_method("moment", setup)
    state, fed, sent, expected = stream.init(log.raw[0]), 0, [spoken(times[0], "counts", [1.0])], []
    for k in range(SAMPLES):
        while arrivals[fed] <= times[k]:
            values = np.zeros(layout.size)
            values[layout.joint_position] = angle[fed]
            values[layout.accelerometer], values[layout.gyroscope] = imu[fed, :3], imu[fed, 3:]
            beliefs.update((Packet(fed, 1e-9 * arrivals[fed], values),))
            sent.append(spoken(arrivals[fed], "joint_states", [9.0, *angle[fed]]))
            sent.append(spoken(arrivals[fed], "imu", imu[fed]))
            fed += 1
        if k == FROZEN:
            sent.append(spoken(times[k], "~/freeze", [1.0]))
        sent.append(spoken(times[k], "counts", log.raw[k]))
        beliefs.sample(1e-9 * times[k] - lag * log.dt - age, None, k >= FROZEN)
        dt = 1e-9 * (times[k] - times[k - 1]) if k else log.dt
        state, estimate = stream.update(state, log.raw[k], beliefs.believed, dt)
        expected.append(estimate)
    sent += [spoken(times[-1], name) for name in ("~/save", "~/stop", "~/start")]
    done = subprocess.run(
        [program, tmp_path / "parameters"], input="\n".join(sent), capture_output=True, text=True, check=True
    )
    said = [line.split() for line in done.stdout.splitlines()]
    assert (
        " ".join(said[0]) == "warned A message of 'counts' has 1 numbers, and 8 are needed; it was left out."
    )
    assert [line[:2] for line in said if line[0] in ("~/freeze", "~/save", "~/stop", "~/start")] == [
        [name, "1"] for name in ("~/freeze", "~/save", "~/stop", "~/start")
    ]
    published = {
        name: np.array([line[1:] for line in said if line[0] == name], dtype=float)
        for name in ("~/force", "~/map", "~/flags")
    }
    for name, wanted in {
        "~/force": [np.concatenate([one.force, one.force_std]) for one in expected],
        "~/map": [np.concatenate([one.scale, one.offset]) for one in expected],
        "~/flags": [one.flags for one in expected],
    }.items():
        np.testing.assert_allclose(published[name], np.array(wanted), rtol=1e-6, atol=1e-7, err_msg=name)
    learnt = published["~/map"]
    assert np.abs(learnt[-1, 8:] - initial.offset).max() > 0.1
    cop = [line for line in said if line[0] == "~/cop"][-1]
    assert cop[1] == "level"
    saved = yaml.safe_load((tmp_path / "saved.yaml").read_text())["surefoot"]["ros__parameters"]
    np.testing.assert_allclose(saved["scale_N_per_count"] + saved["offset_N"], learnt[-1], rtol=1e-14)
