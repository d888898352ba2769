// A ROS 2 node that calibrates a robot's feet while it moves: surefoot's moment filter, one step a sample.
//
// in:   counts   std_msgs/Float64MultiArray, the channels in the layout's order, NaN where no sample arrived
//       beliefs  std_msgs/Float64MultiArray: com (3), com_acceleration (3), angular_momentum_rate (3), position_sole
//                (3 a foot), R_level_sole (9 a foot), stance (1 a foot), swing (1 a foot); the newest counts
// out:  ~/force  std_msgs/Float64MultiArray, calibrated forces in N, then their standard deviations
//       ~/map    std_msgs/Float64MultiArray, scales in N per count, then offsets in N
//       ~/flags  std_msgs/Int32MultiArray, a word a channel
//       ~/cop    geometry_msgs/PointStamped, centre of pressure in the beliefs' level frame, m; z is its larger
//                standard deviation
//       ~/wrench_0, ~/wrench_1  geometry_msgs/WrenchStamped, of the ground on each foot in its sole frame
// parameters:  level_frame, sole_frames: what the stamped messages name as their frames

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <geometry_msgs/msg/point_stamped.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>
#include <std_msgs/msg/int32_multi_array.hpp>

#include "robot.h"  // sizes and constants of this robot, and the header

using Numbers = std_msgs::msg::Float64MultiArray;
using Flags = std_msgs::msg::Int32MultiArray;
using Point = geometry_msgs::msg::PointStamped;
using Wrench = geometry_msgs::msg::WrenchStamped;

class Surefoot : public rclcpp::Node {
public:
    Surefoot() : Node("surefoot"), beliefs_(9 + 14 * robot.feet, std::nan("")) {
        level_ = declare_parameter<std::string>("level_frame", "level");
        soles_ = declare_parameter<std::vector<std::string>>("sole_frames", {"l_sole", "r_sole"});
        soles_.resize(robot.feet);
        force_ = create_publisher<Numbers>("~/force", 10);
        map_ = create_publisher<Numbers>("~/map", 10);
        flags_ = create_publisher<Flags>("~/flags", 10);
        cop_ = create_publisher<Point>("~/cop", 10);
        for (int foot = 0; foot < robot.feet; foot++)
            wrench_.push_back(create_publisher<Wrench>("~/wrench_" + std::to_string(foot), 10));
        sf_calibrator_init(&robot, &state_);
        from_beliefs_ = create_subscription<Numbers>("beliefs", 10, [this](const Numbers &message) {
            if (fits(message, beliefs_.size(), "beliefs")) beliefs_ = message.data;
        });
        from_counts_ = create_subscription<Numbers>("counts", 10, [this](const Numbers &message) {
            if (fits(message, robot.channels, "counts")) sample(message.data);
        });
    }

private:
    bool fits(const Numbers &message, std::size_t wanted, const char *topic) {
        if (message.data.size() == wanted) return true;
        RCLCPP_WARN(get_logger(), "A message of '%s' has %zu numbers, and %zu are needed; it was left out.",
                    topic, message.data.size(), wanted);
        return false;
    }

    void sample(const std::vector<double> &counts) {
        const rclcpp::Time time = now();
        // Until the first beliefs arrive theirs are NaN: the filter learns nothing of them.
        const double dt = last_.nanoseconds() ? (time - last_).seconds() : robot.dt;
        last_ = time;
        const double *from = beliefs_.data();
        sf_reference reference;
        from = take(from, reference.com, 3);
        from = take(from, reference.com_acceleration, 3);
        from = take(from, reference.angular_momentum_rate, 3);
        from = take(from, reference.position_sole, 3 * robot.feet);
        from = take(from, reference.R_level_sole, 9 * robot.feet);
        for (int foot = 0; foot < robot.feet; foot++) {
            reference.stance[foot] = from[foot] > 0.5;
            reference.swing[foot] = from[robot.feet + foot] > 0.5;
        }
        sf_estimate answer;
        sf_calibrator_step(&robot, &state_, counts.data(), &reference, dt, &answer);
        const int K = robot.channels;
        force_->publish(numbers(answer.force, answer.force_std, K));
        map_->publish(numbers(answer.scale, answer.offset, K));
        Flags flags;
        flags.data.assign(answer.flags, answer.flags + K);
        flags_->publish(flags);
        Point cop;
        cop.header.stamp = time;
        cop.header.frame_id = level_;
        cop.point.x = answer.cop[0];
        cop.point.y = answer.cop[1];
        cop.point.z = std::sqrt(std::max(answer.cop_covariance[0], answer.cop_covariance[3]));
        cop_->publish(cop);
        for (std::size_t foot = 0; foot < wrench_.size(); foot++) {
            const double *w = answer.wrench + 6 * foot;
            Wrench wrench;
            wrench.header.stamp = time;
            wrench.header.frame_id = soles_[foot];
            wrench.wrench.force.x = w[0];
            wrench.wrench.force.y = w[1];
            wrench.wrench.force.z = w[2];
            wrench.wrench.torque.x = w[3];
            wrench.wrench.torque.y = w[4];
            wrench.wrench.torque.z = w[5];
            wrench_[foot]->publish(wrench);
        }
    }

    static const double *take(const double *from, sf_real *to, int n) {
        std::copy(from, from + n, to);
        return from + n;
    }

    static Numbers numbers(const double *first, const double *second, int n) {
        Numbers message;
        message.data.assign(first, first + n);
        message.data.insert(message.data.end(), second, second + n);
        return message;
    }

    sf_state state_;
    std::vector<double> beliefs_;
    std::string level_;
    std::vector<std::string> soles_;
    rclcpp::Time last_{0, 0, RCL_ROS_TIME};
    rclcpp::Publisher<Numbers>::SharedPtr force_, map_;
    rclcpp::Publisher<Flags>::SharedPtr flags_;
    rclcpp::Publisher<Point>::SharedPtr cop_;
    std::vector<rclcpp::Publisher<Wrench>::SharedPtr> wrench_;
    rclcpp::Subscription<Numbers>::SharedPtr from_beliefs_, from_counts_;
};

int main(int argc, char **argv) {
    rclcpp::init(argc, argv);
    rclcpp::spin(std::make_shared<Surefoot>());
    rclcpp::shutdown();
    return 0;
}
