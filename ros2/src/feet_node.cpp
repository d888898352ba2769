// A lifecycle node that calibrates a robot's feet while it moves: surefoot's moment filter, one step a sample.
//
// in:   counts        std_msgs/Float64MultiArray, the channels in the layout's order, NaN where no sample arrived
//       wrench_<foot> geometry_msgs/WrenchStamped, in place of counts where each foot has one six-axis sensor
//       joint_states  sensor_msgs/JointState, with the hinges of the parameter joints
//       imu           sensor_msgs/Imu, acceleration with gravity
// out:  ~/force  std_msgs/Float64MultiArray, calibrated forces in N, then their standard deviations
//       ~/map    std_msgs/Float64MultiArray, scales in N per count, then offsets in N
//       ~/flags  std_msgs/Int32MultiArray, a word a channel
//       ~/cop    geometry_msgs/PointStamped, centre of pressure in the level frame of the beliefs, m; z is its larger
//                standard deviation
//       ~/wrench_<foot>      geometry_msgs/WrenchStamped, of the ground on each foot in its sole frame
//       ~/subtracted_<foot>  the same of what was taken off: by the starting map less calibrated
//       /diagnostics         diagnostic_msgs/DiagnosticArray, once a second
// services:    ~/start (std_srvs/Trigger) begins again from the map of the parameters, ~/stop leaves samples out,
//              ~/freeze (std_srvs/SetBool) learns nothing or goes on, ~/save writes the map, ~/tare says that all feet
//              hang in the air for the next tare_s
// parameters:  those that `surefoot calibrate walk LOG --ros2` writes, and
//              tare_s: duration of a tare, 1 s; save_to: file of ~/save; level_frame: frame of ~/cop;
//              autostart: whether the node configures and activates itself, true

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <geometry_msgs/msg/point_stamped.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <lifecycle_msgs/msg/state.hpp>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp_lifecycle/lifecycle_node.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#include <std_msgs/msg/float64_multi_array.hpp>
#include <std_msgs/msg/int32_multi_array.hpp>
#include <std_srvs/srv/set_bool.hpp>
#include <std_srvs/srv/trigger.hpp>

#include "robot.hpp"
#include "wrench.hpp"

using Numbers = std_msgs::msg::Float64MultiArray;
using Flags = std_msgs::msg::Int32MultiArray;
using Point = geometry_msgs::msg::PointStamped;
using Wrench = geometry_msgs::msg::WrenchStamped;
using JointState = sensor_msgs::msg::JointState;
using Imu = sensor_msgs::msg::Imu;
using Diagnostics = diagnostic_msgs::msg::DiagnosticArray;
using Status = diagnostic_msgs::msg::DiagnosticStatus;
using SetBool = std_srvs::srv::SetBool;
using Trigger = std_srvs::srv::Trigger;
template <class M> using Publisher = std::shared_ptr<rclcpp_lifecycle::LifecyclePublisher<M>>;
template <class M> using Subscription = typename rclcpp::Subscription<M>::SharedPtr;

// Flags in the order of their bits.
constexpr const char *FLAGS[] = {"MISSING", "OUT_OF_RANGE", "REFERENCE", "GAP",  "NO_CONTACT", "SINGULAR", "STANDING",  "REJECTED",
                                 "SPIKE",   "STUCK",        "DEAD",      "FLIPPED", "SWAPPED", "LOST",     "SATURATED", "HELD",
                                 "WORSE_THAN_START"};
// Those that a healthy robot does not have for long.
constexpr long long WRONG = SF_MISSING | SF_OUT_OF_RANGE | SF_GAP | SF_SINGULAR | SF_SPIKE | SF_STUCK | SF_DEAD |
                            SF_FLIPPED | SF_SWAPPED | SF_LOST | SF_SATURATED;

// Periods of packets without one from which on some were lost.
constexpr double SILENCE = 3;

class Feet : public rclcpp_lifecycle::LifecycleNode {
public:
    Feet() : LifecycleNode("surefoot", rclcpp::NodeOptions().automatically_declare_parameters_from_overrides(true)) {}

    CallbackReturn on_configure(const rclcpp_lifecycle::State &) override {
        try {
            read_parameters();
        } catch (const std::exception &problem) {
            RCLCPP_ERROR(get_logger(), "%s", problem.what());
            return CallbackReturn::FAILURE;
        }
        begin();
        force_ = create_publisher<Numbers>("~/force", 10);
        map_ = create_publisher<Numbers>("~/map", 10);
        flags_ = create_publisher<Flags>("~/flags", 10);
        cop_ = create_publisher<Point>("~/cop", 10);
        diagnostics_ = create_publisher<Diagnostics>("/diagnostics", 10);
        for (const std::string &foot : feet_) {
            wrench_.push_back(create_publisher<Wrench>("~/wrench_" + foot, 10));
            subtracted_.push_back(create_publisher<Wrench>("~/subtracted_" + foot, 10));
        }
        serve("~/start", [this] { return begin(), answer(true, "begun from the starting map"); });
        serve("~/stop", [this] { return running_ = false, answer(true, "stopped; ~/start begins again"); });
        serve("~/save", [this] { return save(); });
        serve("~/tare", [this] { return tare(); });
        using Asked = std::shared_ptr<SetBool::Request>;
        freeze_ = create_service<SetBool>("~/freeze", [this](const Asked asked, std::shared_ptr<SetBool::Response> told) {
            frozen_ = asked->data;
            told->success = true;
            told->message = frozen_ ? "nothing is learnt" : "learning goes on";
        });
        return CallbackReturn::SUCCESS;
    }

    CallbackReturn on_activate(const rclcpp_lifecycle::State &state) override {
        const auto qos = rclcpp::SensorDataQoS().keep_last(50);
        joint_states_ = create_subscription<JointState>("joint_states", qos, [this](const JointState &m) { take_joints(m); });
        imu_ = create_subscription<Imu>("imu", qos, [this](const Imu &m) { take_imu(m); });
        counts_ = create_subscription<Numbers>("counts", qos, [this](const Numbers &m) {
            if (m.data.size() == reading_.size()) sample(m.data, now().nanoseconds());
            else
                RCLCPP_WARN(get_logger(), "A message of 'counts' has %zu numbers, and %zu are needed; it was left out.",
                            m.data.size(), reading_.size());
        });
        for (std::size_t foot = 0; reading_.size() == 6 * feet_.size() && foot < feet_.size(); foot++)
            wrenches_.push_back(create_subscription<Wrench>("wrench_" + feet_[foot], qos,
                                                            [this, foot](const Wrench &m) { take_wrench(foot, m); }));
        timer_ = create_wall_timer(std::chrono::seconds(1), [this] { diagnose(); });
        return LifecycleNode::on_activate(state);
    }

    CallbackReturn on_deactivate(const rclcpp_lifecycle::State &state) override {
        joint_states_.reset(), imu_.reset(), counts_.reset(), wrenches_.clear(), timer_.reset();
        return LifecycleNode::on_deactivate(state);
    }

    CallbackReturn on_cleanup(const rclcpp_lifecycle::State &) override {
        force_.reset(), map_.reset(), flags_.reset(), cop_.reset(), diagnostics_.reset();
        wrench_.clear(), subtracted_.clear(), services_.clear(), freeze_.reset();
        return CallbackReturn::SUCCESS;
    }

private:
    // ------------------------------------------------------------------------------------------- parameters

    template <class T> T parameter(const std::string &name) const {
        T value;
        if (!get_parameter(name, value))
            throw std::runtime_error("The parameter '" + name + "' is missing; `surefoot calibrate walk LOG --ros2` writes " +
                                     "it, of a log with joints, an IMU and a drawing.");
        return value;
    }

    std::vector<double> numbers(const std::string &name, std::size_t size) const {
        const auto values = parameter<std::vector<double>>(name);
        if (values.size() != size)
            throw std::runtime_error("The parameter '" + name + "' has " + std::to_string(values.size()) + " numbers, and " +
                                     std::to_string(size) + " are needed.");
        return values;
    }

    void read_parameters() {
        constants_ = read_robot([this](const std::string &name) { return parameter<std::vector<double>>(name); });
        const std::size_t K = robot_.channels, hinges = model_.hinges;
        const auto rotation = numbers("R_torso_imu", 9);
        std::copy(rotation.begin(), rotation.end(), R_torso_imu_);
        angle_ = numbers("held_rad", hinges);  // NaN of those that are to come
        channels_ = parameter<std::vector<std::string>>("channels");
        joints_ = parameter<std::vector<std::string>>("joints");
        feet_ = parameter<std::vector<std::string>>("feet");
        soles_ = parameter<std::vector<std::string>>("sole_frames");
        const std::size_t F = robot_.feet;
        if (channels_.size() != K || joints_.size() != hinges || feet_.size() != F || soles_.size() != F)
            throw std::runtime_error("The parameters 'channels', 'joints', 'feet' and 'sole_frames' must name all of each.");
        age_ = parameter<double>("readings_age_s");
        get_parameter("tare_s", tare_s_);
        get_parameter("save_to", save_to_);
        get_parameter("level_frame", level_);
        reading_.assign(K, std::nan(""));
        seen_.assign(K, 0);
    }

    // -------------------------------------------------------------------------------------------- messages

    // Nanoseconds of a header, or of now where it has none.
    template <class M> long long stamp(const M &message) {
        const auto &at = message.header.stamp;
        const long long ns = 1000000000LL * at.sec + at.nanosec;
        return ns ? ns : now().nanoseconds();
    }

    // Seconds since the first message: small numbers have more digits.
    double seconds(long long ns) {
        if (!epoch_) epoch_ = ns;
        return 1e-9 * double(ns - epoch_);
    }

    void take_joints(const JointState &message) {
        for (std::size_t i = 0; i < joints_.size(); i++) {
            const auto found = std::find(message.name.begin(), message.name.end(), joints_[i]);
            const std::size_t k = std::size_t(found - message.name.begin());
            if (k < message.position.size()) angle_[i] = message.position[k];
        }
    }

    // A packet is an IMU's message with the last angles; angles that never came are NaN, which is refused.
    void take_imu(const Imu &message) {
        const auto &a = message.linear_acceleration, &w = message.angular_velocity;
        const sf_real force_imu[3] = {a.x, a.y, a.z}, spin_imu[3] = {w.x, w.y, w.z};
        sf_real force[3], spin[3];
        sf_turn(force, R_torso_imu_, force_imu);
        sf_turn(spin, R_torso_imu_, spin_imu);
        const double time = seconds(stamp(message)), period = timing_.period / timing_.joined;
        // Messages are late by chance; a longer silence shows that some were lost, and leaves a gap in the numbers.
        const bool silent = packet_ >= 0 && time - imu_time_ > SILENCE * timing_.period;
        packet_ += silent ? std::llround((time - imu_time_) / period) : 1;
        imu_time_ = time;
        sf_momentum_packet(&model_, &timing_, &beliefs_, packet_, time, angle_.data(), force, spin);
    }

    // A sample is whole when all feet have come; a foot that comes again before the others shows that theirs were lost.
    void take_wrench(std::size_t foot, const Wrench &message) {
        double *const first = reading_.data() + 6 * foot;
        if (*first == *first) sample_wrenches();
        read_wrench(message.wrench, first);
        wrench_time_ = stamp(message);
        if (std::none_of(reading_.begin(), reading_.end(), [](double x) { return std::isnan(x); })) sample_wrenches();
    }

    void sample_wrenches() {
        sample(reading_, wrench_time_);
        std::fill(reading_.begin(), reading_.end(), std::nan(""));
    }

    // ---------------------------------------------------------------------------------------------- sample

    void begin() {
        sf_moment_init(&robot_, &moment_, &state_, &work_);
        sf_momentum_beliefs_init(&beliefs_);
        packet_ = -1, last_ = tare_ = 0, running_ = true, known_ = false;
    }

    void sample(const std::vector<double> &counts, long long ns) {
        if (!running_) return;
        const double time = seconds(ns), dt = last_ ? 1e-9 * double(ns - last_) : robot_.dt;
        last_ = ns;
        sf_belief belief;
        sf_momentum_sample(&timing_, &beliefs_, time - robot_.lag * timing_.dt - age_, nullptr, frozen_, &belief);
        if (belief.fell) sf_moment_retract(&robot_, &moment_, &state_);
        // References are about some samples ago, and so is the first one of a tare.
        if (tare_ > 0 && tare_-- <= tare_samples())
            for (int foot = 0; foot < robot_.feet; foot++) belief.reference.stance[foot] = 0, belief.reference.swing[foot] = 1;
        known_ = belief.known;
        sf_moment_step(&robot_, &moment_, &state_, &work_, counts.data(), &belief.reference, dt, &estimate_);
        note();
        publish(counts, ns);
    }

    long long tare_samples() const { return std::llround(tare_s_ / robot_.dt); }

    void publish(const std::vector<double> &counts, long long ns) {
        const int K = robot_.channels;
        const rclcpp::Time time(ns, RCL_ROS_TIME);
        force_->publish(pair_of(estimate_.force, estimate_.force_std));
        map_->publish(pair_of(estimate_.scale, estimate_.offset));
        Flags flags;
        flags.data.assign(estimate_.flags, estimate_.flags + K);
        flags_->publish(flags);
        Point cop;
        cop.header.stamp = time;
        cop.header.frame_id = level_;
        cop.point.x = estimate_.cop[0];
        cop.point.y = estimate_.cop[1];
        cop.point.z = std::sqrt(std::max(estimate_.cop_covariance[0], estimate_.cop_covariance[3]));
        cop_->publish(cop);
        sf_real off[SF_CHANNELS], wrench[6];
        for (int i = 0; i < K; i++) off[i] = robot_.scale[i] * counts[i] + robot_.offset[i] - estimate_.force[i];
        for (std::size_t foot = 0; foot < feet_.size(); foot++) {
            wrench_[foot]->publish(wrench_of(estimate_.wrench + 6 * foot, foot, time));
            for (int axis = 0; axis < 6; axis++) wrench[axis] = sf_dot(robot_.wrench_map + (6 * foot + axis) * K, off, K);
            subtracted_[foot]->publish(wrench_of(wrench, foot, time));
        }
    }

    Numbers pair_of(const double *first, const double *second) const {
        Numbers message;
        message.data.assign(first, first + robot_.channels);
        message.data.insert(message.data.end(), second, second + robot_.channels);
        return message;
    }

    Wrench wrench_of(const double *w, std::size_t foot, const rclcpp::Time &time) const {
        Wrench message;
        message.header.stamp = time;
        message.header.frame_id = soles_[foot];
        write_wrench(w, message.wrench);
        return message;
    }

    // -------------------------------------------------------------------------------------------- services

    template <class F> void serve(const std::string &name, F f) {
        using Asked = std::shared_ptr<Trigger::Request>;
        services_.push_back(create_service<Trigger>(
            name, [f](const Asked, std::shared_ptr<Trigger::Response> told) { *told = f(); }));
    }

    static Trigger::Response answer(bool success, const std::string &message) {
        Trigger::Response told;
        told.success = success;
        told.message = message;
        return told;
    }

    Trigger::Response tare() {
        if (!running_ || frozen_ || !known_)
            return answer(false, !running_ ? "stopped; ~/start first" : frozen_ ? "frozen; learn first" : missing());
        tare_ = tare_samples() + robot_.lag;
        return answer(true, "all feet are taken to hang in the air for the next " + text(tare_s_) + " s");
    }

    // The file is there whole or not at all.
    Trigger::Response save() const {
        if (!last_) return answer(false, "no sample was taken in yet");
        const std::string part = save_to_ + ".part";
        std::ofstream file(part);
        file.precision(17);
        file << get_name() << ":\n  ros__parameters:\n";
        for (const auto &[name, values] : {std::pair{"scale_N_per_count", estimate_.scale}, {"offset_N", estimate_.offset}}) {
            file << "    " << name << ":\n";
            for (int i = 0; i < robot_.channels; i++)
                file << "    - " << values[i] << (values[i] == std::floor(values[i]) ? ".0\n" : "\n");
        }
        file.close();
        const bool done = file && std::rename(part.c_str(), save_to_.c_str()) == 0;
        return answer(done, (done ? "written to " : "cannot write to ") + save_to_);
    }

    // ----------------------------------------------------------------------------------------- diagnostics

    // Of a sample, for the diagnostics of its second.
    void note() {
        samples_++;
        unknown_ += !known_;
        for (int i = 0; i < robot_.channels; i++) seen_[i] |= estimate_.flags[i];
        if (estimate_.nis_rows > 0 && std::isfinite(estimate_.nis)) nis_ += estimate_.nis, nis_rows_ += estimate_.nis_rows;
    }

    std::string missing() const {
        for (std::size_t i = 0; i < joints_.size(); i++)
            if (std::isnan(angle_[i])) return "'joint_states' never had the joint " + joints_[i];
        return packet_ < 0 ? "no message of 'imu' came" : "the robot's motion is not known: it just began, lost packets or fell";
    }

    void diagnose() {
        Status status;
        status.name = std::string(get_name()) + ": feet";
        long long all = 0;
        double undetermined = 0;
        for (std::size_t i = 0; i < channels_.size(); i++) {
            all |= seen_[i];
            undetermined = std::max(undetermined, estimate_.undetermined[i]);
            std::string names;
            for (int bit = 0; bit < 16; bit++)
                if (seen_[i] >> bit & 1) names += (names.empty() ? "" : " ") + std::string(FLAGS[bit]);
            add(status, "flags " + channels_[i], names);
        }
        add(status, "samples", std::to_string(samples_));
        add(status, "nis per row", nis_rows_ > 0 ? text(nis_ / nis_rows_) : "");
        add(status, "undetermined share", last_ ? text(undetermined) : "");
        for (std::size_t foot = 0; foot < feet_.size(); foot++)
            add(status, "tare of " + feet_[foot], state_.tare.time[foot] < 0 ? "" : text(state_.time - state_.tare.time[foot]) + " s ago");
        const bool none = running_ && !samples_, blind = running_ && !frozen_ && samples_ && unknown_ == samples_;
        status.level = none ? Status::ERROR : blind || all & (WRONG | SF_WORSE_THAN_START) ? Status::WARN : Status::OK;
        status.message = !running_ ? "stopped"
                         : none    ? "no sample of the feet came"
                         : frozen_ ? "frozen"
                         : blind   ? missing()
                         : all & WRONG   ? "channels have flags"
                         : all & SF_HELD ? "somebody holds the robot"
                         : all & SF_WORSE_THAN_START ? "the learnt map is worse than the start"
                                         : "learning";
        Diagnostics message;
        message.header.stamp = now();
        message.status.push_back(status);
        diagnostics_->publish(message);
        samples_ = unknown_ = 0, nis_ = nis_rows_ = 0;
        std::fill(seen_.begin(), seen_.end(), 0);
    }

    static void add(Status &status, const std::string &key, const std::string &value) {
        status.values.emplace_back();
        status.values.back().key = key;
        status.values.back().value = value;
    }

    static std::string text(double value) {
        char digits[32];
        std::snprintf(digits, sizeof digits, "%.3g", value);
        return digits;
    }

    Robot constants_;
    const sf_config &robot_ = constants_.config;
    const sf_moment_config &moment_ = constants_.moment;
    const sf_model &model_ = constants_.model;
    const sf_timing &timing_ = constants_.timing;
    sf_moment_state state_{};
    sf_moment_work work_;  // of which nothing is remembered
    sf_momentum_beliefs beliefs_;
    sf_estimate estimate_{};
    sf_real R_torso_imu_[9];
    std::vector<double> angle_, reading_;  // of the hinges in rad, the last that came; of six-axis sensors, so far
    std::vector<std::string> channels_, joints_, feet_, soles_;
    std::string level_ = "level", save_to_ = "surefoot.yaml";
    double age_ = 0, tare_s_ = 1, imu_time_ = 0, nis_ = 0, nis_rows_ = 0;  // age: of counts when they arrive, s
    long long epoch_ = 0, last_ = 0, wrench_time_ = 0;                     // ns
    long long packet_ = -1, tare_ = 0, samples_ = 0, unknown_ = 0;         // tare_: samples to go
    std::vector<long long> seen_;                                          // flags of this second
    bool running_ = true, frozen_ = false, known_ = false;
    Publisher<Numbers> force_, map_;
    Publisher<Flags> flags_;
    Publisher<Point> cop_;
    Publisher<Diagnostics> diagnostics_;
    std::vector<Publisher<Wrench>> wrench_, subtracted_;
    Subscription<Numbers> counts_;
    Subscription<JointState> joint_states_;
    Subscription<Imu> imu_;
    std::vector<Subscription<Wrench>> wrenches_;
    std::vector<rclcpp::Service<Trigger>::SharedPtr> services_;
    rclcpp::Service<SetBool>::SharedPtr freeze_;
    rclcpp::TimerBase::SharedPtr timer_;
};

int main(int argc, char **argv) {
    rclcpp::init(argc, argv);
    const auto node = std::make_shared<Feet>();
    bool autostart = true;
    node->get_parameter("autostart", autostart);
    if (autostart && node->configure().id() == lifecycle_msgs::msg::State::PRIMARY_STATE_INACTIVE) node->activate();
    rclcpp::spin(node->get_node_base_interface());
    rclcpp::shutdown();
    return 0;
}
