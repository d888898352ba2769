// A filter for chains of geometry_msgs/WrenchStamped, as those of ros2_control's force_torque_sensor_broadcaster: a
// six-axis sensor's readings in, the calibrated wrench out, without the weight of the tool.
//
//     wrench = matrix (readings - offset) - (m g, m c x g)
//
// parameters, as `surefoot calibrate ft` writes them into *.in_situ.ros2.yaml:
//     matrix: six rows of N and N m per reading, (fx fy fz tx ty tz); without one the readings are a wrench
//     offset: six readings; none by default
//     gravity_frame: a frame whose z axis points up; empty leaves the tool's weight in
//     tool_mass_kg, tool_com_m: of what hangs on the sensor, in the frame of the messages
//
// A wrench is exerted by the tool on the robot: at rest the tool's is m g, and g points down.

#include <memory>
#include <string>
#include <vector>

#include <filters/filter_base.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <pluginlib/class_list_macros.hpp>
#include <rclcpp/rclcpp.hpp>
#if __has_include(<tf2_ros/buffer.hpp>)
#include <tf2_ros/buffer.hpp>
#include <tf2_ros/transform_listener.hpp>
#else
#include <tf2_ros/buffer.h>
#include <tf2_ros/transform_listener.h>
#endif

#include "wrench.hpp"

namespace surefoot_ros {

using Wrench = geometry_msgs::msg::WrenchStamped;

class CalibratedWrench : public filters::FilterBase<Wrench> {
public:
    bool configure() override {
        mass_ = 0;
        frame_.clear();
        if (!numbers("matrix", 36, matrix_) || !numbers("offset", 6, offset_) || !numbers("tool_com_m", 3, com_)) return false;
        getParam("gravity_frame", frame_);
        getParam("tool_mass_kg", mass_);
        if (!frame_.empty() && !listener_) {
            clock_ = std::make_shared<rclcpp::Clock>(RCL_ROS_TIME);
            buffer_ = std::make_unique<tf2_ros::Buffer>(clock_);
            listener_ = std::make_unique<tf2_ros::TransformListener>(*buffer_, true);
        }
        return true;
    }

    bool update(const Wrench &in, Wrench &out) override {
        double left[6], wrench[6];
        read_wrench(in.wrench, left);
        for (std::size_t k = 0; k < offset_.size(); k++) left[k] -= offset_[k];
        for (int row = 0; row < 6; row++) {
            wrench[row] = matrix_.empty() ? left[row] : 0;
            for (int k = 0; k < 6 && !matrix_.empty(); k++) wrench[row] += matrix_[6 * row + k] * left[k];
        }
        if (!frame_.empty() && !take_off_tool(in.header.frame_id, wrench)) return false;
        out.header = in.header;
        write_wrench(wrench, out.wrench);
        return true;
    }

private:
    bool numbers(const std::string &name, std::size_t size, std::vector<double> &to) {
        to.clear();
        getParam(name, to);
        if (to.empty() || to.size() == size) return true;
        RCLCPP_ERROR(logging_interface_->get_logger(), "The parameter '%s%s' has %zu numbers, and %zu are needed, or none.",
                     param_prefix_.c_str(), name.c_str(), to.size(), size);
        return false;
    }

    // Subtract the tool's weight, of which the attitude of the sensor's frame is needed.
    bool take_off_tool(const std::string &sensor, double *wrench) {
        double up[3];
        try {
            const auto q = buffer_->lookupTransform(sensor, frame_, tf2::TimePointZero).transform.rotation;
            // The third column of the rotation by a quaternion.
            up[0] = 2 * (q.x * q.z + q.w * q.y), up[1] = 2 * (q.y * q.z - q.w * q.x), up[2] = 1 - 2 * (q.x * q.x + q.y * q.y);
        } catch (const tf2::TransformException &problem) {
            RCLCPP_ERROR_THROTTLE(logging_interface_->get_logger(), *clock_, 5000,
                                  "The tool's weight cannot be taken off without the attitude of '%s' in '%s': %s",
                                  sensor.c_str(), frame_.c_str(), problem.what());
            return false;
        }
        double g[3], c[3] = {0, 0, 0};
        for (int k = 0; k < 3; k++) g[k] = -GRAVITY * mass_ * up[k];
        for (std::size_t k = 0; k < com_.size(); k++) c[k] = com_[k];
        for (int k = 0; k < 3; k++) {
            const int i = (k + 1) % 3, j = (k + 2) % 3;
            wrench[k] -= g[k];
            wrench[3 + k] -= c[i] * g[j] - c[j] * g[i];
        }
        return true;
    }

    static constexpr double GRAVITY = 9.81;  // m/s^2, as surefoot.calibration.reference.GRAVITY

    std::vector<double> matrix_, offset_, com_;
    double mass_ = 0;
    std::string frame_;
    rclcpp::Clock::SharedPtr clock_;
    std::unique_ptr<tf2_ros::Buffer> buffer_;
    std::unique_ptr<tf2_ros::TransformListener> listener_;
};

}  // namespace surefoot_ros

PLUGINLIB_EXPORT_CLASS(surefoot_ros::CalibratedWrench, filters::FilterBase<geometry_msgs::msg::WrenchStamped>)
