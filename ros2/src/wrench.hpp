// The six numbers of a geometry_msgs/Wrench: fx fy fz tx ty tz.

#pragma once

template <class Message> void read_wrench(const Message &from, double *wrench) {
    const auto &f = from.force, &t = from.torque;
    const double numbers[6] = {f.x, f.y, f.z, t.x, t.y, t.z};
    for (int k = 0; k < 6; k++) wrench[k] = numbers[k];
}

template <class Message> void write_wrench(const double *wrench, Message &to) {
    to.force.x = wrench[0], to.force.y = wrench[1], to.force.z = wrench[2];
    to.torque.x = wrench[3], to.torque.y = wrench[4], to.torque.z = wrench[5];
}
