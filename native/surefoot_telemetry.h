/* What a robot's own computer measures and sends, in C99: joint encoders, an IMU, the tilt that follows from
   them, and a link that brings packets late, with jitter and in order.

   The specification is the Python: sensors/telemetry/computer.py and attitude.py, sensors/devices/encoders.py
   and imu.py, sensors/transport/link.py. A test holds the two together; docs/native.md tells how to use this
   file. Nothing is allocated, nothing is global, and nothing is read or written but what is passed in.

       sf_telemetry_config config;     constants, written by surefoot.sensors.telemetry.native
       sf_telemetry state;             all that is remembered, a plain record that may be copied
       count = sf_telemetry_init(&config, &state, position, inertial, 1, &stream, packets);
       count = sf_telemetry_advance(&config, &state, position, inertial, time, &stream, packets);

   A packet is a row of 10 + 2 J numbers: its number, when it arrives, J joint angles and J velocities, roll and
   pitch, angular velocity (3) and specific force (3).

   Before it is included: SF_SINGLE makes numbers floats (times stay doubles); SF_JOINTS and SF_LINK_ROOM are the
   largest sizes; SF_API is what stands before functions. */

#ifndef SUREFOOT_TELEMETRY_H
#define SUREFOOT_TELEMETRY_H

#include "surefoot_random.h"

#ifndef SF_JOINTS
#define SF_JOINTS 64
#endif
#ifndef SF_LINK_ROOM
#define SF_LINK_ROOM 64 /* under way at a time */
#endif
#define SF_PACKET (10 + 2 * SF_JOINTS)

/* Constants of the Python modules, by their names there. */
#define SF_LINK_ROUNDING 1e-9
#define SF_PROPORTIONAL_GAIN ((sf_real)0.3)
#define SF_INTEGRAL_GAIN ((sf_real)0.02)
#define SF_LEAST_SQUARE ((sf_real)24.0)
#define SF_LARGEST_SPIN_SQUARE ((sf_real)1e12)
#define SF_MOST_SQUARE ((sf_real)217.0)

/* ------------------------------------------------------------------------------------------------ records */

/* Constants of one robot: a Telemetry with its Imu, Encoders and Link. Six numbers are those of the
   accelerometer, then of the gyroscope. */
typedef struct {
    int joints, substeps, before_start, room; /* room: packets under way at a time, at most */
    int averaged, skewed; /* whether a sample is a mean; whether the IMU's axes are a little off */
    double dt, substep, period, delay, jitter;
    sf_real interval, smoothing; /* the period, and the share that the velocity filter takes */
    sf_real encoders_bias_std, encoders_noise_std, encoders_resolution; /* a step of 0 does not round */
    sf_real bias_std[6], spread[18]; /* of what is drawn at power-up */
    sf_real walk[6], noise[6];           /* standard deviations a packet */
    sf_real step[6], most[6];            /* resolution and range; 0 for neither */
} sf_telemetry_config;

/* All that is remembered: TelemetryState, Computer and Attitude side by side. */
typedef struct {
    double due;                       /* time to the next packet */
    int64_t number, substeps;         /* of the next packet; in the sum `inertial` */
    int64_t first, waiting;           /* packets under way: the place of the oldest in `ring`, and how many */
    sf_real bias[6], matrix[18];      /* of the IMU */
    sf_real error[SF_JOINTS];         /* of the encoders */
    sf_real up[3], gyroscope_bias[3]; /* what the computer believes */
    sf_real position[SF_JOINTS], velocity[SF_JOINTS], inertial[6];
    double arrival[SF_LINK_ROOM];
    sf_real ring[SF_LINK_ROOM * SF_PACKET]; /* as wide as the robot's packets: what follows need not be there */
} sf_telemetry;

SF_API int sf_packet_size(const sf_telemetry_config *c) { return 10 + 2 * c->joints; }

/* Return whether a robot fits into the arrays; call it once for a config that comes from elsewhere. */
SF_API int sf_telemetry_fits(const sf_telemetry_config *c) {
    int most = c->period > 0 ? (int)fmin(c->dt / c->period, SF_LINK_ROOM) + 1 : SF_LINK_ROOM + 1;
    if (c->room < 1 || c->room > SF_LINK_ROOM) return 0;
    return c->joints >= 0 && c->joints <= SF_JOINTS && c->substeps >= 1 && c->before_start >= 0 &&
           c->before_start <= c->room - most && c->dt > 0 && c->substep > 0;
}

/* Return how many packets the next step sends; -1 if there is no room for them. */
SF_API int sf_telemetry_coming(const sf_telemetry_config *c, const sf_telemetry *s) {
    int count = 0;
    for (double due = s->due; due <= c->dt + 1e-9; due += c->period)
        if (s->waiting + ++count > c->room) return -1;
    return count;
}

/* ---------------------------------------------------------------------------------------------- measuring */

SF_API sf_real sf_round_to(sf_real value, sf_real step) {
    return step != 0 ? (sf_real)rint((double)(value / step)) * step : value;
}

/* Read the encoders: a constant error, noise, and steps. */
SF_API void sf_encoders(const sf_telemetry_config *c, const sf_telemetry *s, const sf_real *position,
                        sf_random *stream, sf_real *angle) {
    int J = c->joints;
    if (c->encoders_noise_std != 0)
        sf_random_fill(stream, 1, J, angle);
    else
        memset(angle, 0, (size_t)J * sizeof(sf_real));
    for (int j = 0; j < J; j++)
        angle[j] = sf_round_to(position[j] + s->error[j] + c->encoders_noise_std * angle[j], c->encoders_resolution);
}

/* Read the IMU: axes a little off, a drifting bias, and samples that are noisy, clipped and rounded. */
SF_API void sf_imu(const sf_telemetry_config *c, sf_telemetry *s, const sf_real *inertial,
                   sf_random *stream, sf_real *sample) {
    sf_real drawn[12];
    sf_random_fill(stream, 1, 12, drawn);
    for (int i = 0; i < 6; i++) {
        sf_real felt = inertial[i];
        if (c->skewed) {
            const sf_real *axis = s->matrix + 3 * i, *three = inertial + (i < 3 ? 0 : 3);
            felt = axis[0] * three[0] + axis[1] * three[1] + axis[2] * three[2];
        }
        s->bias[i] += c->walk[i] * drawn[i];
        felt = felt + s->bias[i] + c->noise[i] * drawn[6 + i];
        if (c->most[i] != 0 && felt > c->most[i]) felt = c->most[i];
        if (c->most[i] != 0 && felt < -c->most[i]) felt = -c->most[i];
        sample[i] = sf_round_to(felt, c->step[i]);
    }
}

/* Turn the belief of what is up on by one sample: `update` of sensors/telemetry/attitude.py. */
SF_API void sf_attitude(sf_telemetry *s, const sf_real *gyroscope, const sf_real *accelerometer, sf_real dt) {
    sf_real x = s->up[0], y = s->up[1], z = s->up[2], *b = s->gyroscope_bias;
    sf_real wx = gyroscope[0] - b[0], wy = gyroscope[1] - b[1], wz = gyroscope[2] - b[2];
    if (!(wx * wx + wy * wy + wz * wz < SF_LARGEST_SPIN_SQUARE)) return; /* NaN compares as false */
    sf_real ax = accelerometer[0], ay = accelerometer[1], az = accelerometer[2];
    sf_real square = ax * ax + ay * ay + az * az, ex = 0, ey = 0, ez = 0;
    if (SF_LEAST_SQUARE < square && square < SF_MOST_SQUARE) {
        sf_real weight = 1 / (sf_real)sqrt((double)square), gain = SF_INTEGRAL_GAIN * dt;
        ax *= weight;
        ay *= weight;
        az *= weight;
        ex = y * az - z * ay;
        ey = z * ax - x * az;
        ez = x * ay - y * ax;
        b[0] += gain * ex;
        b[1] += gain * ey;
        b[2] += gain * ez;
    }
    sf_real tx = (SF_PROPORTIONAL_GAIN * ex - wx) * dt;
    sf_real ty = (SF_PROPORTIONAL_GAIN * ey - wy) * dt;
    sf_real tz = (SF_PROPORTIONAL_GAIN * ez - wz) * dt;
    sf_real dx = ty * z - tz * y, dy = tz * x - tx * z, dz = tx * y - ty * x, half = (sf_real)0.5;
    x += dx + half * (ty * dz - tz * dy);
    y += dy + half * (tz * dx - tx * dz);
    z += dz + half * (tx * dy - ty * dx);
    sf_real norm = 1 / (sf_real)sqrt((double)(x * x + y * y + z * z));
    s->up[0] = x * norm;
    s->up[1] = y * norm;
    s->up[2] = z * norm;
}

/* ------------------------------------------------------------------------------------------------ packets */

SF_API sf_real *sf_packet(const sf_telemetry_config *c, sf_telemetry *s, int64_t place) {
    return s->ring + (s->first + place) % c->room * sf_packet_size(c);
}

/* Read the sensors once and send a packet at a time of the host's clock. */
SF_API void sf_measure_and_send(const sf_telemetry_config *c, sf_telemetry *s, const sf_real *position,
                                const sf_real *felt, double time, sf_random *stream) {
    int J = c->joints;
    sf_real angle[SF_JOINTS + 1], sample[6], late, *row = sf_packet(c, s, s->waiting);
    sf_real *accelerometer = sample, *gyroscope = sample + 3, *tail = row + 2 + 2 * J;
    sf_encoders(c, s, position, stream, angle);
    sf_imu(c, s, felt, stream, sample);
    sf_attitude(s, gyroscope, accelerometer, c->interval);
    for (int j = 0; j < J; j++) {
        sf_real rate = (angle[j] - s->position[j]) / c->interval;
        if (isnan(s->velocity[j])) s->velocity[j] = 0;
        s->velocity[j] += c->smoothing * (rate - s->velocity[j]);
        s->position[j] = angle[j];
        row[2 + j] = angle[j];
        row[2 + J + j] = s->velocity[j];
    }
    sf_real x = s->up[0] > 1 ? 1 : s->up[0] < -1 ? -1 : s->up[0];
    tail[0] = (sf_real)atan2((double)s->up[1], (double)s->up[2]);
    tail[1] = -(sf_real)asin((double)x);
    memcpy(tail + 2, gyroscope, 3 * sizeof(sf_real));
    memcpy(tail + 5, accelerometer, 3 * sizeof(sf_real));

    double delay = c->delay;
    if (c->jitter != 0) {
        sf_random_fill(stream, 1, 1, &late);
        delay = fmax(0.0, delay + c->jitter * (double)late);
    }
    double arrival = time + delay;
    if (s->waiting > 0) arrival = fmax(arrival, s->arrival[(s->first + s->waiting - 1) % c->room]);
    s->arrival[(s->first + s->waiting) % c->room] = arrival;
    row[0] = (sf_real)s->number;
    row[1] = (sf_real)arrival;
    s->number++;
    s->waiting++;
}

/* Hand out what has arrived by a time; return how many packets. */
SF_API int sf_receive(const sf_telemetry_config *c, sf_telemetry *s, double time, sf_real *arrived) {
    int count = 0, size = sf_packet_size(c);
    for (; s->waiting > 0 && s->arrival[s->first] <= time + SF_LINK_ROUNDING; count++) {
        memcpy(arrived + count * size, sf_packet(c, s, 0), (size_t)size * sizeof(sf_real));
        s->first = (s->first + 1) % c->room;
        s->waiting--;
    }
    return count;
}

/* Switch the robot on at rest, some packets before time 0.

   position (J) and inertial (6) are what is true then. With `fresh` an IMU and encoders are drawn; otherwise
   `bias`, `matrix` and `error` of the state are those to keep. `arrived` holds `room` rows; the number of
   those that have arrived by time 0 is returned. */
SF_API int sf_telemetry_init(const sf_telemetry_config *c, sf_telemetry *s, const sf_real *position,
                             const sf_real *inertial, int fresh, sf_random *stream, sf_real *arrived) {
    if (fresh) {
        memset(s, 0, (size_t)((char *)s->ring - (char *)s));
        sf_random_fill(stream, 1, 6, s->bias);
        for (int i = 0; i < 6; i++) s->bias[i] *= c->bias_std[i];
        if (c->skewed) sf_random_fill(stream, 1, 18, s->matrix);
        for (int i = 0; i < 18; i++) s->matrix[i] = (i % 9 % 4 == 0) + c->spread[i] * s->matrix[i];
        sf_random_fill(stream, 1, c->joints, s->error);
        for (int j = 0; j < c->joints; j++) s->error[j] *= c->encoders_bias_std;
    }
    sf_encoders(c, s, position, stream, s->position);
    memset(s->velocity, 0, sizeof s->velocity);
    memset(s->inertial, 0, sizeof s->inertial);
    memset(s->gyroscope_bias, 0, sizeof s->gyroscope_bias);
    s->up[0] = s->up[1] = 0;
    s->up[2] = 1;
    s->number = s->substeps = s->first = s->waiting = 0;
    for (int n = 0; n < c->before_start; n++)
        sf_measure_and_send(c, s, position, inertial, (n + 1 - c->before_start) * c->period, stream);
    s->due = c->period;
    return sf_receive(c, s, 0, arrived);
}

/* Measure a control step.

   position (S, J) and inertial (S, 6) are what is true at the ends of its S substeps, time is the host's at its
   end. `arrived` holds `room` rows; the number of packets that have arrived is returned, or -1 if more are
   under way than there is room for: nothing has happened then. */
SF_API int sf_telemetry_advance(const sf_telemetry_config *c, sf_telemetry *s, const sf_real *position,
                                const sf_real *inertial, double time, sf_random *stream, sf_real *arrived) {
    int rows = c->substeps, row = 0;
    double start = time - c->dt, due = s->due;
    if (sf_telemetry_coming(c, s) < 0) return -1;
    for (; due <= c->dt + 1e-9; due += c->period) {
        sf_real felt[6];
        int last = (int)(due / c->substep - 1e-6);
        if (last < row) last = row;
        if (last > rows - 1) last = rows - 1;
        memcpy(felt, inertial + 6 * last, sizeof felt);
        if (c->averaged)
            for (int i = 0; i < 6; i++) {
                sf_real sum = 0;
                for (int k = row; k <= last; k++) sum += inertial[6 * k + i];
                felt[i] = (sum + s->inertial[i]) / (sf_real)(s->substeps + last + 1 - row);
                s->inertial[i] = 0;
            }
        s->substeps = 0;
        sf_measure_and_send(c, s, position + last * c->joints, felt, start + due, stream);
        row = last + 1;
    }
    if (row < rows && c->averaged) {
        for (int i = 0; i < 6; i++) {
            sf_real sum = 0;
            for (int k = row; k < rows; k++) sum += inertial[6 * k + i];
            s->inertial[i] += sum;
        }
        s->substeps += rows - row;
    }
    s->due = due - c->dt;
    return sf_receive(c, s, time, arrived);
}

#endif
