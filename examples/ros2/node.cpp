// A ROS 2 node that calibrates a biped's feet while it moves: surefoot's moment filter, one step a sample.
//
// in:   counts        std_msgs/Float64MultiArray, the channels in the layout's order, NaN where no sample arrived
//       joint_states  sensor_msgs/JointState, with the hinges of model.h under the names of the parameter joints
//       imu           sensor_msgs/Imu, axes along the torso's: angular velocity, and acceleration with gravity
// out:  ~/force  std_msgs/Float64MultiArray, calibrated forces in N, then their standard deviations
//       ~/map    std_msgs/Float64MultiArray, scales in N per count, then offsets in N: what was taken off
//       ~/flags  std_msgs/Int32MultiArray, a word a channel
//       ~/cop    geometry_msgs/PointStamped, centre of pressure in the level frame of the beliefs, m; z is its larger
//                standard deviation
//       ~/wrench_0, ~/wrench_1  geometry_msgs/WrenchStamped, of the ground on each foot in its sole frame
// services:    ~/start (std_srvs/Trigger) begins again from the map of the parameters, ~/stop leaves samples out,
//              ~/freeze (std_srvs/SetBool) learns nothing or goes on, ~/save (std_srvs/Trigger) writes the map
// parameters:  scale_N_per_count, offset_N: the starting map, as `surefoot calibrate walk LOG --ros2` writes it, by
//                default that of robot.h
//              joints: names of the hinges in the order of model.h
//              readings_age_s: how long before they arrive counts were measured
//              save_to: the file of ~/save, of the form of --ros2
//              level_frame, sole_frames: what the stamped messages name as their frames
//
// robot.h is what c_source of surefoot.calibration.native writes, model.h that of surefoot.robot.beliefs.native.

#include <algorithm>
#include <cmath>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include <geometry_msgs/msg/point_stamped.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>
#include <std_msgs/msg/int32_multi_array.hpp>
#include <std_srvs/srv/set_bool.hpp>
#include <std_srvs/srv/trigger.hpp>

#include "robot.h"  // sizes and constants of this robot, and the filter
#include "model.h"  // its bodies and hinges, and what it believes of its motion

using Numbers = std_msgs::msg::Float64MultiArray;
using Flags = std_msgs::msg::Int32MultiArray;
using Point = geometry_msgs::msg::PointStamped;
using Wrench = geometry_msgs::msg::WrenchStamped;
using JointState = sensor_msgs::msg::JointState;
using Imu = sensor_msgs::msg::Imu;
using SetBool = std_srvs::srv::SetBool;
using Trigger = std_srvs::srv::Trigger;

class Surefoot : public rclcpp::Node {
public:
    Surefoot() : Node("surefoot"), config_(robot), angle_(model.hinges, std::nan("")) {
        level_ = declare_parameter<std::string>("level_frame", "level");
        soles_ = declare_parameter<std::vector<std::string>>("sole_frames", {"l_sole", "r_sole"});
        soles_.resize(robot.feet);
        joints_ = declare_parameter<std::vector<std::string>>("joints", {});
        age_ = declare_parameter<double>("readings_age_s", 0.0);
        save_to_ = declare_parameter<std::string>("save_to", "surefoot.yaml");
        starting_map("scale_N_per_count", config_.scale);
        starting_map("offset_N", config_.offset);
        force_ = create_publisher<Numbers>("~/force", 10);
        map_ = create_publisher<Numbers>("~/map", 10);
        flags_ = create_publisher<Flags>("~/flags", 10);
        cop_ = create_publisher<Point>("~/cop", 10);
        for (int foot = 0; foot < robot.feet; foot++)
            wrench_.push_back(create_publisher<Wrench>("~/wrench_" + std::to_string(foot), 10));
        sf_moment_init(&config_, &moment, &state_, &work_);
        sf_momentum_beliefs_init(&beliefs_);
        from_joints_ = create_subscription<JointState>("joint_states", 10, [this](const JointState &m) { move(m); });
        from_imu_ = create_subscription<Imu>("imu", 10, [this](const Imu &m) { turn(m); });
        from_counts_ = create_subscription<Numbers>("counts", 10, [this](const Numbers &message) {
            if (message.data.size() == std::size_t(robot.channels)) sample(message.data);
            else
                RCLCPP_WARN(get_logger(), "A message of 'counts' has %zu numbers, and %d are needed; it was left out.",
                            message.data.size(), robot.channels);
        });
        using Asked = std::shared_ptr<Trigger::Request>;
        using Told = std::shared_ptr<Trigger::Response>;
        start_ = create_service<Trigger>("~/start", [this](const Asked, Told told) {
            sf_moment_init(&config_, &moment, &state_, &work_);
            running_ = true;
            *told = done(true, "begun from the starting map");
        });
        stop_ = create_service<Trigger>("~/stop", [this](const Asked, Told told) {
            running_ = false;
            *told = done(true, "stopped; ~/start begins again");
        });
        save_ = create_service<Trigger>("~/save", [this](const Asked, Told told) { *told = save(); });
        freeze_ = create_service<SetBool>(
            "~/freeze", [this](const std::shared_ptr<SetBool::Request> asked, std::shared_ptr<SetBool::Response> told) {
                frozen_ = asked->data;
                told->success = true;
                told->message = frozen_ ? "nothing is learnt" : "learning goes on";
            });
    }

private:
    void starting_map(const char *name, sf_real *to) {
        const std::vector<double> given = declare_parameter<std::vector<double>>(name, std::vector<double>());
        if (given.size() == std::size_t(robot.channels)) std::copy(given.begin(), given.end(), to);
        else if (!given.empty())
            RCLCPP_WARN(get_logger(), "The parameter '%s' has %zu numbers, and %d are needed; robot.h has its own.",
                        name, given.size(), robot.channels);
    }

    void move(const JointState &message) {
        for (std::size_t i = 0; i < std::min(joints_.size(), angle_.size()); i++) {
            const auto place = std::find(message.name.begin(), message.name.end(), joints_[i]);
            const std::size_t k = std::size_t(place - message.name.begin());
            if (k < message.position.size()) angle_[i] = message.position[k];
        }
    }

    // A packet is an IMU's message with the last angles; angles that never came are NaN, which is refused.
    void turn(const Imu &message) {
        const auto &a = message.linear_acceleration, &w = message.angular_velocity;
        const sf_real force[3] = {a.x, a.y, a.z}, spin[3] = {w.x, w.y, w.z};
        sf_momentum_packet(&model, &timing, &beliefs_, packets_++, seconds(now()), angle_.data(), force, spin);
    }

    static double seconds(const rclcpp::Time &time) { return 1e-9 * double(time.nanoseconds()); }

    void sample(const std::vector<double> &counts) {
        if (!running_) return;
        const rclcpp::Time time = now();
        const double dt = last_.nanoseconds() ? (time - last_).seconds() : config_.dt;
        last_ = time;
        sf_belief belief;
        const double about = seconds(time) - config_.lag * timing.dt - age_;
        sf_momentum_sample(&timing, &beliefs_, about, nullptr, frozen_, &belief);
        if (belief.fell) sf_moment_retract(&config_, &moment, &state_);
        sf_estimate answer;
        sf_moment_step(&config_, &moment, &state_, &work_, counts.data(), &belief.reference, dt, &answer);
        scale_.assign(answer.scale, answer.scale + robot.channels);
        offset_.assign(answer.offset, answer.offset + robot.channels);
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

    Trigger::Response save() const {
        if (scale_.empty()) return done(false, "no sample was taken in yet");
        std::ofstream file(save_to_);
        file.precision(17);
        file << "surefoot:\n  ros__parameters:\n";
        for (const auto &[name, values] : {std::pair{"scale_N_per_count", &scale_}, {"offset_N", &offset_}}) {
            file << "    " << name << ":\n";
            for (double value : *values) file << "    - " << value << (value == std::floor(value) ? ".0\n" : "\n");
        }
        file.close();
        return done(bool(file), file ? "written to " + save_to_ : "cannot write to " + save_to_);
    }

    static Trigger::Response done(bool success, const std::string &message) {
        Trigger::Response told;
        told.success = success;
        told.message = message;
        return told;
    }

    static Numbers numbers(const double *first, const double *second, int n) {
        Numbers message;
        message.data.assign(first, first + n);
        message.data.insert(message.data.end(), second, second + n);
        return message;
    }

    sf_config config_;  // that of robot.h with the map of the parameters
    sf_moment_state state_;
    sf_moment_work work_;  // of which nothing is remembered
    sf_momentum_beliefs beliefs_;
    std::vector<sf_real> angle_;  // of the hinges in rad, the last that came
    std::vector<double> scale_, offset_;
    std::string level_, save_to_;
    std::vector<std::string> soles_, joints_;
    double age_;  // of counts when they arrive in s
    sf_whole packets_ = 0;
    bool running_ = true, frozen_ = false;
    rclcpp::Time last_{0, 0, RCL_ROS_TIME};
    rclcpp::Publisher<Numbers>::SharedPtr force_, map_;
    rclcpp::Publisher<Flags>::SharedPtr flags_;
    rclcpp::Publisher<Point>::SharedPtr cop_;
    std::vector<rclcpp::Publisher<Wrench>::SharedPtr> wrench_;
    rclcpp::Subscription<Numbers>::SharedPtr from_counts_;
    rclcpp::Subscription<JointState>::SharedPtr from_joints_;
    rclcpp::Subscription<Imu>::SharedPtr from_imu_;
    rclcpp::Service<Trigger>::SharedPtr start_, stop_, save_;
    rclcpp::Service<SetBool>::SharedPtr freeze_;
};

int main(int argc, char **argv) {
    rclcpp::init(argc, argv);
    rclcpp::spin(std::make_shared<Surefoot>());
    rclcpp::shutdown();
    return 0;
}
