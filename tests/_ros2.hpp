// Stand-ins for as much of ROS 2 as the package in ros2/ uses, with the signatures of rclcpp 29, rclcpp_lifecycle 29,
// filters 2.1, pluginlib and tf2_ros. A program reads parameters from the file of its first argument, a line each with
// name, kind and values, and messages from standard input, a line each with the time in ns, the topic and numbers. It
// prints what is published, answered and logged.
#pragma once
#include <chrono>
#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace builtin_interfaces::msg { struct Time { std::int32_t sec = 0; std::uint32_t nanosec = 0; }; }
namespace std_msgs::msg {
struct Header { builtin_interfaces::msg::Time stamp; std::string frame_id; };
struct Float64MultiArray { std::vector<double> data; };
struct Int32MultiArray { std::vector<std::int32_t> data; };
}
namespace geometry_msgs::msg {
struct Vector3 { double x = 0, y = 0, z = 0; };
struct Quaternion { double x = 0, y = 0, z = 0, w = 1; };
struct PointStamped { std_msgs::msg::Header header; Vector3 point; };
struct WrenchStamped { std_msgs::msg::Header header; struct { Vector3 force, torque; } wrench; };
struct TransformStamped { std_msgs::msg::Header header; struct { Vector3 translation; Quaternion rotation; } transform; };
}
namespace sensor_msgs::msg {
struct JointState { std_msgs::msg::Header header; std::vector<std::string> name; std::vector<double> position; };
struct Imu { std_msgs::msg::Header header; geometry_msgs::msg::Vector3 angular_velocity, linear_acceleration; };
}
namespace diagnostic_msgs::msg {
struct KeyValue { std::string key, value; };
struct DiagnosticStatus {
    static constexpr unsigned char OK = 0, WARN = 1, ERROR = 2;
    unsigned char level = 0;
    std::string name, message, hardware_id;
    std::vector<KeyValue> values;
};
struct DiagnosticArray { std_msgs::msg::Header header; std::vector<DiagnosticStatus> status; };
}
namespace std_srvs::srv {
struct Trigger { struct Request {}; struct Response { bool success = false; std::string message; }; };
struct SetBool { struct Request { bool data = false; }; struct Response { bool success = false; std::string message; }; };
}
namespace lifecycle_msgs::msg { struct State { static constexpr unsigned char PRIMARY_STATE_INACTIVE = 2; }; }

#define RCL_ROS_TIME rclcpp::ROS_TIME
#define RCLCPP_LOG_(kind, ...) (std::printf(kind " "), std::printf(__VA_ARGS__), std::printf("\n"))
#define RCLCPP_WARN(logger, ...) ((void)(logger), RCLCPP_LOG_("warned", __VA_ARGS__))
#define RCLCPP_ERROR(logger, ...) ((void)(logger), RCLCPP_LOG_("error", __VA_ARGS__))
#define RCLCPP_ERROR_THROTTLE(logger, clock, duration, ...) \
    ((void)(clock), (void)(duration), RCLCPP_ERROR(logger, __VA_ARGS__))

namespace rclcpp {
enum rcl_clock_type_t { ROS_TIME = 1 };
struct Logger {};
struct Time {
    std::int64_t ns;
    explicit Time(std::int64_t nanoseconds = 0, rcl_clock_type_t = ROS_TIME) : ns(nanoseconds) {}
    std::int64_t nanoseconds() const { return ns; }
    operator builtin_interfaces::msg::Time() const {
        return {std::int32_t(ns / 1000000000), std::uint32_t(ns % 1000000000)};
    }
};
struct Clock {
    using SharedPtr = std::shared_ptr<Clock>;
    explicit Clock(rcl_clock_type_t) {}
};
struct QoS {
    QoS(std::size_t) {}
    QoS &keep_last(std::size_t) { return *this; }
};
struct SensorDataQoS : QoS { SensorDataQoS() : QoS(5) {} };
struct NodeOptions {
    NodeOptions &automatically_declare_parameters_from_overrides(bool) { return *this; }
};
struct TimerBase { using SharedPtr = std::shared_ptr<TimerBase>; };

// Parameters: lists of texts, with the kind that ROS's own reader of YAML gives them.
struct Given { std::string kind; std::vector<std::string> values; };
inline std::map<std::string, Given> given;
inline std::map<std::string, std::function<void(const std::vector<double> &)>> callbacks;
inline std::int64_t clock_ns = 0;
inline void need(const Given &from, const char *kind) {
    if (from.kind != kind) throw std::runtime_error("expected [" + std::string(kind) + "] got [" + from.kind + "]");
}
inline void get(const Given &from, double &to) { need(from, "double"); to = std::stod(from.values[0]); }
inline void get(const Given &from, bool &to) { need(from, "bool"); to = from.values[0] == "True"; }
inline void get(const Given &from, std::string &to) { need(from, "string"); to = from.values.empty() ? "" : from.values[0]; }
inline void get(const Given &from, std::vector<std::string> &to) { need(from, "string_array"); to = from.values; }
inline void get(const Given &from, std::vector<double> &to) {
    need(from, "double_array");
    to.clear();
    for (const std::string &one : from.values) to.push_back(std::stod(one));
}

inline void show(double v) { std::printf(" %.17g", v); }
inline void show(const geometry_msgs::msg::Vector3 &v) { show(v.x), show(v.y), show(v.z); }
inline void show(const std_msgs::msg::Float64MultiArray &m) { for (double v : m.data) show(v); }
inline void show(const std_msgs::msg::Int32MultiArray &m) { for (int v : m.data) show(v); }
inline void show(const geometry_msgs::msg::PointStamped &m) { std::printf(" %s", m.header.frame_id.c_str()), show(m.point); }
inline void show(const geometry_msgs::msg::WrenchStamped &m) {
    std::printf(" %s %.9f", m.header.frame_id.c_str(), m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec);
    show(m.wrench.force), show(m.wrench.torque);
}
inline void show(const diagnostic_msgs::msg::DiagnosticArray &m) {
    for (const auto &status : m.status) {
        std::printf(" %d|%s|%s", status.level, status.name.c_str(), status.message.c_str());
        for (const auto &one : status.values) std::printf("|%s=%s", one.key.c_str(), one.value.c_str());
    }
}

inline builtin_interfaces::msg::Time stamp() { return Time(clock_ns); }
inline void heard(const std::vector<double> &v, std_msgs::msg::Float64MultiArray &m) { m.data = v; }
inline void heard(const std::vector<double> &v, sensor_msgs::msg::JointState &m) {
    m.name = {"other"};  // one that the node does not know, before those that are not held
    for (std::size_t i = 0; i < given["joints"].values.size(); i++)
        if (given["held_rad"].values[i] == "nan") m.name.push_back(given["joints"].values[i]);
    m.position = v;
}
inline void heard(const std::vector<double> &v, sensor_msgs::msg::Imu &m) {
    m = {{stamp(), ""}, {v[3], v[4], v[5]}, {v[0], v[1], v[2]}};
}
inline void heard(const std::vector<double> &v, geometry_msgs::msg::WrenchStamped &m) {
    m = {{stamp(), "sensor"}, {{v[0], v[1], v[2]}, {v[3], v[4], v[5]}}};
}
inline void ask(const std::vector<double> &, std_srvs::srv::Trigger::Request &) {}
inline void ask(const std::vector<double> &v, std_srvs::srv::SetBool::Request &r) { r.data = v[0] > 0.5; }

template <class M> struct Subscription { using SharedPtr = std::shared_ptr<Subscription>; };
template <class S> struct Service { using SharedPtr = std::shared_ptr<Service>; };
inline void init(int, char **argv) {
    std::ifstream file(argv[1]);
    for (std::string line; std::getline(file, line);) {
        std::istringstream words(line);
        std::string name, word;
        words >> name >> given[name].kind;
        while (words >> word) given[name].values.push_back(word);
    }
}
inline void shutdown() {}
inline void spin(int) {
    for (std::string line; std::getline(std::cin, line);) {
        std::istringstream words(line);
        std::string topic, word;
        std::vector<double> values;
        words >> clock_ns >> topic;
        while (words >> word) values.push_back(std::stod(word));
        if (callbacks.count(topic)) callbacks[topic](values);
        else std::printf("nobody %s\n", topic.c_str());
    }
}
}  // namespace rclcpp

namespace rclcpp_lifecycle {
struct State {
    std::uint8_t number;
    std::uint8_t id() const { return number; }
};
template <class M> struct LifecyclePublisher {
    std::string topic;
    const bool *active;
    void publish(const M &m) {
        if (*active) std::printf("%s", topic.c_str()), rclcpp::show(m), std::printf("\n");
    }
};
class LifecycleNode {
public:
    enum class CallbackReturn : std::uint8_t { SUCCESS, FAILURE, ERROR };
    LifecycleNode(const std::string &name, const rclcpp::NodeOptions &) : name_(name) {
        move("configure", [this] { configure(); });
        move("activate", [this] { activate(); });
        move("deactivate", [this] { on_deactivate(state_), state_ = {2}; });
        move("cleanup", [this] { on_cleanup(state_), state_ = {1}; });
    }
    virtual ~LifecycleNode() = default;
    virtual CallbackReturn on_configure(const State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_activate(const State &) { return active_ = true, CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_deactivate(const State &) { return active_ = false, CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_cleanup(const State &) { return CallbackReturn::SUCCESS; }
    const State &configure() {
        state_ = {std::uint8_t(on_configure(state_) == CallbackReturn::SUCCESS ? 2 : 1)};
        return state_;
    }
    const State &activate() { return on_activate(state_), state_ = {3}, state_; }
    const char *get_name() const { return name_.c_str(); }
    rclcpp::Logger get_logger() const { return {}; }
    rclcpp::Time now() const { return rclcpp::Time(rclcpp::clock_ns); }
    int get_node_base_interface() const { return 0; }
    template <class T> bool get_parameter(const std::string &name, T &value) const {
        if (!rclcpp::given.count(name)) return false;
        try {
            rclcpp::get(rclcpp::given[name], value);
        } catch (const std::runtime_error &wrong) {
            throw std::runtime_error("parameter '" + name + "' has invalid type: " + wrong.what());
        }
        return true;
    }
    template <class M> std::shared_ptr<LifecyclePublisher<M>> create_publisher(const std::string &topic, const rclcpp::QoS &) {
        return std::make_shared<LifecyclePublisher<M>>(LifecyclePublisher<M>{topic, &active_});
    }
    template <class M, class F>
    std::shared_ptr<rclcpp::Subscription<M>> create_subscription(const std::string &topic, const rclcpp::QoS &, F &&f) {
        rclcpp::callbacks[topic] = [f](const std::vector<double> &v) { M m{}; rclcpp::heard(v, m); f(m); };
        return std::shared_ptr<rclcpp::Subscription<M>>(new rclcpp::Subscription<M>, [topic](rclcpp::Subscription<M> *gone) {
            rclcpp::callbacks.erase(topic), delete gone;
        });
    }
    template <class S, class F> typename rclcpp::Service<S>::SharedPtr create_service(const std::string &name, F &&f) {
        rclcpp::callbacks[name] = [f, name](const std::vector<double> &v) {
            auto asked = std::make_shared<typename S::Request>();
            auto told = std::make_shared<typename S::Response>();
            rclcpp::ask(v, *asked);
            f(asked, told);
            std::printf("%s %d %s\n", name.c_str(), told->success, told->message.c_str());
        };
        return std::make_shared<rclcpp::Service<S>>();
    }
    template <class Rep, class Period, class F>
    rclcpp::TimerBase::SharedPtr create_wall_timer(std::chrono::duration<Rep, Period>, F f) {
        rclcpp::callbacks["timer"] = [f](const std::vector<double> &) { f(); };
        return std::make_shared<rclcpp::TimerBase>();
    }

private:
    template <class F> void move(const std::string &name, F f) {
        rclcpp::callbacks[name] = [f](const std::vector<double> &) { f(); };
    }
    std::string name_;
    State state_{1};
    bool active_ = false;
};
}  // namespace rclcpp_lifecycle

namespace rclcpp::node_interfaces {
struct NodeLoggingInterface {
    using SharedPtr = std::shared_ptr<NodeLoggingInterface>;
    Logger get_logger() const { return {}; }
};
struct NodeParametersInterface { using SharedPtr = std::shared_ptr<NodeParametersInterface>; };
}
namespace filters {
template <class T> class FilterBase {
public:
    virtual ~FilterBase() = default;
    bool configure(const std::string &prefix, const std::string &name,
                   const rclcpp::node_interfaces::NodeLoggingInterface::SharedPtr &logger,
                   const rclcpp::node_interfaces::NodeParametersInterface::SharedPtr &parameters) {
        param_prefix_ = prefix.empty() || prefix.back() == '.' ? prefix : prefix + '.';
        filter_name_ = name, logging_interface_ = logger, params_interface_ = parameters;
        return configured_ = configure();
    }
    virtual bool update(const T &data_in, T &data_out) = 0;

protected:
    virtual bool configure() = 0;
    // As in ROS true also for a parameter that is not there, which becomes zero or empty.
    template <class P> bool getParam(const std::string &name, P &value) {
        value = P();
        if (rclcpp::given.count(param_prefix_ + name)) rclcpp::get(rclcpp::given[param_prefix_ + name], value);
        return true;
    }
    std::string filter_name_, param_prefix_;
    bool configured_ = false;
    rclcpp::node_interfaces::NodeLoggingInterface::SharedPtr logging_interface_;
    rclcpp::node_interfaces::NodeParametersInterface::SharedPtr params_interface_;
};
}
// Instead of a loader: the one filter of a program.
inline std::shared_ptr<void> exported;
#define PLUGINLIB_EXPORT_CLASS(Class, Base)                                                                   \
    static_assert(std::is_base_of_v<Base, Class>);                                                            \
    static const bool exported_here = (exported = std::shared_ptr<Base>(std::make_shared<Class>()), true);
namespace tf2 {
struct TransformException : std::runtime_error { using std::runtime_error::runtime_error; };
using TimePoint = std::chrono::time_point<std::chrono::system_clock, std::chrono::nanoseconds>;
constexpr TimePoint TimePointZero{};
}
namespace tf2_ros {
inline geometry_msgs::msg::Quaternion attitude;  // of "world" in "sensor"
struct Buffer {
    explicit Buffer(rclcpp::Clock::SharedPtr) {}
    geometry_msgs::msg::TransformStamped lookupTransform(const std::string &target, const std::string &source, tf2::TimePoint) const {
        if (target != "sensor" || source != "world") throw tf2::TransformException("no frame " + target + " or " + source);
        geometry_msgs::msg::TransformStamped found;
        found.transform.rotation = attitude;
        return found;
    }
};
struct TransformListener { TransformListener(Buffer &, bool) {} };
}
