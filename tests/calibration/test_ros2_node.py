"""The example of a ROS 2 node, compiled against stand-ins for ROS: its numbers are those of Python."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from surefoot.calibration import OnlineSetup, Parameters, Reference, nao_shoe_layout
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.stream import MomentStream
from surefoot.calibration.native import NATIVE, c_source
from surefoot.calibration.native.library import installed

NODE = Path(__file__).parents[2] / "examples" / "ros2" / "node.cpp"
DT = 0.0125

STAND_IN = r"""
#pragma once
#include <cstdio>
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
using Callback = std::function<void(const std_msgs::msg::Float64MultiArray &)>;
inline std::map<std::string, Callback> callbacks;
inline long clock_ns = 5000000000L;
struct Node {
    explicit Node(const std::string &) {}
    template <class T> T declare_parameter(const std::string &, const T &value) { return value; }
    template <class M> typename Publisher<M>::SharedPtr create_publisher(const std::string &topic, int) {
        return std::make_shared<Publisher<M>>(Publisher<M>{topic});
    }
    template <class M, class F>
    typename Subscription<M>::SharedPtr create_subscription(const std::string &topic, int, F f) {
        callbacks[topic] = f;
        return std::make_shared<Subscription<M>>();
    }
    Time now() const { return Time(0, clock_ns, RCL_ROS_TIME); }
    int get_logger() const { return 0; }
};
inline void init(int, char **) {}
inline void shutdown() {}
template <class N> void spin(const std::shared_ptr<N> &) {
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string topic, word;
        words >> topic;
        std_msgs::msg::Float64MultiArray message;
        while (words >> word) message.data.push_back(std::stod(word));
        if (topic == "counts") clock_ns += 12500000L;
        callbacks[topic](message);
    }
}
}
"""


def rows(n: int) -> tuple[np.ndarray, Reference]:
    """A robot that sways on both feet."""
    rng = np.random.default_rng(3)
    time = DT * np.arange(n)
    sway = 0.02 * np.stack([np.sin(3 * time), np.cos(2 * time), 0 * time], axis=-1)
    up, feet = np.tile((0.0, 0.0, 9.81), (n, 1)), np.array([[0.0, 0.05, 0.0], [0.0, -0.05, 0.0]])
    reference = Reference(
        com=sway + np.array((0.02, 0.0, 0.26)),
        com_acceleration=0.1 * sway,
        angular_momentum_rate=0.0 * sway,
        position_sole=np.tile(feet, (n, 1, 1)),
        R_level_sole=np.tile(np.eye(3), (n, 2, 1, 1)),
        stance=np.ones((n, 2), dtype=bool),
        swing=np.zeros((n, 2), dtype=bool),
        accelerometer=up,
        gyroscope=0.0 * up,
    )
    force = 5.3 * 9.81 / 8 * (1.0 + 0.1 * rng.standard_normal((n, 8)))
    counts = (force + 160.0) / 2e-5
    counts[5, 2] = np.nan
    return counts, reference


@pytest.mark.slow
@pytest.mark.skipif(not NODE.is_file(), reason="the examples are not part of the wheel")
@pytest.mark.skipif(shutil.which("c++") is None, reason="needs a C++ compiler")
@pytest.mark.skipif(installed() is None, reason="needs surefoot's library in C: python -m surefoot.native")
def test_the_node_publishes_what_python_finds(tmp_path: Path) -> None:
    initial = Parameters(np.full(8, 2e-5), np.full(8, -160.0))
    setup = OnlineSetup(layout=nao_shoe_layout(), mass=5.3, initial=initial)
    for name in (
        "rclcpp/rclcpp.hpp",
        *(f"std_msgs/msg/{kind}.hpp" for kind in ("float64_multi_array", "int32_multi_array")),
        *(f"geometry_msgs/msg/{kind}.hpp" for kind in ("point_stamped", "wrench_stamped")),
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text('#pragma once\n#include "stand_in.hpp"\n')
    (tmp_path / "stand_in.hpp").write_text(STAND_IN)
    (tmp_path / "robot.h").write_text(c_source(setup))
    includes = (f"-I{tmp_path}", f"-I{NATIVE.sources.folder}")
    program = tmp_path / "node"
    strict = ("-std=c++17", "-O0", "-ffp-contract=off", "-Wall", "-Werror")
    subprocess.run(["c++", *strict, *includes, "-o", program, NODE], check=True)

    counts, reference = rows(200)
    lines = ["beliefs 1 2 3"]
    for k, raw in enumerate(counts):
        row = [np.ravel(part[k]) for part in reference[:7]]
        lines += [" ".join([topic, *map(repr, map(float, values))]) for topic, values in (
            ("beliefs", np.concatenate(row)), ("counts", raw))]  # fmt: skip
    done = subprocess.run([program], input="\n".join(lines), capture_output=True, text=True, check=True)
    said = [line.split() for line in done.stdout.splitlines()]
    assert " ".join(said[0]) == (
        "warned A message of 'beliefs' has 3 numbers, and 37 are needed; it was left out."
    )

    stream = MomentStream(setup, MomentFilterConfig())
    state = stream.init(counts[0])
    for k, raw in enumerate(counts):
        state, estimate = stream.update(state, raw, Reference(*(part[k] for part in reference)), DT)
        force, learnt, flags, cop, left, right = said[1 + 6 * k : 7 + 6 * k]
        found = {
            "force": (force[1:], np.concatenate([estimate.force, estimate.force_std])),
            "map": (learnt[1:], np.concatenate([estimate.scale, estimate.offset])),
            "flags": (flags[1:], estimate.flags),
            "cop": (cop[2:4], estimate.cop),
        }
        for name, (printed, expected) in found.items():
            np.testing.assert_allclose(np.array(printed, float), expected, rtol=1e-7, atol=1e-9, err_msg=name)
        assert (cop[1], left[1], right[1]) == ("level", "l_sole", "r_sole")
        assert float(left[4]) == pytest.approx(float(estimate.vgrf[0]), rel=1e-7)
