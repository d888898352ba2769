/* The sensors' headers as a shared library, with a table of where their records' fields lie. */

#include "surefoot_feet.h"
#include "surefoot_random.h"
#include "surefoot_telemetry.h"

#include "library.h"

#define C_INT(field) PLACE(cells_config, field, "int")
#define C_REAL(field) PLACE(cells_config, field, "real")
#define S_REAL(field) PLACE(cells, field, "real")
#define F_REAL(field) PLACE(force_torque_config, field, "real")
#define G_INT(field) PLACE(strain_gauges_config, field, "int")
#define G_REAL(field) PLACE(strain_gauges_config, field, "real")
#define H_REAL(field) PLACE(strain_gauges, field, "real")
#define B_INT(field) PLACE(faults_config, field, "int")
#define B_REAL(field) PLACE(faults_config, field, "real")
#define T_INT(field) PLACE(telemetry_config, field, "int")
#define T_DOUBLE(field) PLACE(telemetry_config, field, "double")
#define T_REAL(field) PLACE(telemetry_config, field, "real")
#define U_DOUBLE(field) PLACE(telemetry, field, "double")
#define U_WHOLE(field) PLACE(telemetry, field, "whole")
#define R_AT(field) PLACE(sense_records, field, "word")
#define R_INT(field) PLACE(sense_records, field, "int")
#define FEET(field, kind)                                                                                    \
    {"sense_records", #field, kind, offsetof(sf_sense_records, feet.field), sizeof(((sf_feet *)0)->field)}
#define U_REAL(field) PLACE(telemetry, field, "real")

/* Fields of the wire within a device's record. */
#define WIRED(record, field, kind)                                                                           \
    {#record, "wire_" #field, kind, offsetof(sf_##record, wire.field), sizeof(((sf_##record *)0)->wire.field)}
#define WIRE_CONFIG(record)                                                                                  \
    WIRED(record, bits, "int"), WIRED(record, offset_binary, "int"), WIRED(record, late, "int"),             \
        WIRED(record, under_way, "int"), WIRED(record, lowest, "real"), WIRED(record, highest, "real"),      \
        WIRED(record, spike_size, "real"), WIRED(record, spike_rate, "real"),                                \
        WIRED(record, wrong_words, "real"), WIRED(record, stale_repeats, "real"),                            \
        WIRED(record, packet_loss, "real"), WIRED(record, packet_loss_length, "real"),                       \
        WIRED(record, gap_share, "real"), WIRED(record, gap_length, "real"), WIRED(record, delay, "real"),   \
        WIRED(record, jitter, "real")
#define WIRE_STATE(record)                                                                                   \
    WIRED(record, stale_repeats_held, "real"), WIRED(record, packet_loss_lost, "real"),                      \
        WIRED(record, gaps_lost, "real"), WIRED(record, latency_due, "real"),                                \
        WIRED(record, latency_readings, "real"), WIRED(record, latency_held, "real")

/* Arrays that stay where they are, so that a call has few arguments: each costs as much as a sensor. */
typedef struct {
    const sf_telemetry_config *config;
    sf_real *position, *inertial, *arrived;
} telemetry_arrays;

/* The same of what is under one robot's feet, of its telemetry, if anybody listens, and of what is seen. Each of `rows`
   of truth has `columns`, in which joints, IMU, ankles and cells begin at at_... and feet are `stride` apart. The load
   is felt @ map + preload, with `readings` felt; with `soles`, these are wrenches that are made of so many feet first.
   Of `numbers` of the observation `shares` are measured, and the number from[i] of the newest packet is at to[i].
   `packets` have arrived in the last step. */
typedef struct {
    sf_feet feet;
    const sf_real *map, *preload;
    sf_real *load, *wrench;
    const telemetry_arrays *telemetry;
    sf_telemetry *telemetry_state;
    sf_random *telemetry_stream;
    sf_real *newest, *raw;
    const float *observed, *low, *high;
    float *shown, *held, *counts;
    const int32_t *from, *to;
    int rows, columns, at_joints, at_inertial, at_ankles, at_cells, stride, readings, soles, channels, values, numbers,
        shares, averaged, packets;
} sf_sense_records;

/* clang-format off */
static const place places[] = {
    WHOLE_OF(random), PLACE(random, key, "word"), PLACE(random, count, "word"),

    WHOLE_OF(cells_config), WHOLE_OF(cells),

    C_INT(channels), C_INT(clocked), C_INT(averaged), C_INT(settling), C_INT(warms), C_INT(shears), C_INT(plays), C_INT(creeps),
    C_REAL(highest_rate), C_REAL(slope), C_REAL(zero_code), C_REAL(noise_counts), C_REAL(scale_drift),
    C_REAL(offset_drift), C_REAL(temperature_ramp), C_REAL(temperature_rise), C_REAL(capacity),
    C_REAL(nonlinearity), C_REAL(hysteresis), C_REAL(hysteresis_excess), C_REAL(slack),
    C_REAL(creep_shares), C_REAL(creep_time_constants), C_REAL(impact_threshold), C_REAL(mounting_warp_std),
    C_REAL(mounting_common_std), C_REAL(overload_share), C_REAL(safe_load), WIRE_CONFIG(cells_config),

    S_REAL(period), S_REAL(due), S_REAL(charge), S_REAL(held), S_REAL(error), S_REAL(thermal),
    S_REAL(window), S_REAL(mechanics_nonlinearity_quadratic), S_REAL(mechanics_hysteresis_plays),
    S_REAL(mechanics_creep_yielded), S_REAL(mechanics_mounting_offset), S_REAL(mechanics_mounting_load),
    S_REAL(mechanics_mounting_impact), S_REAL(mechanics_overload_excess), S_REAL(shear), WIRE_STATE(cells),

    WHOLE_OF(force_torque_config), WHOLE_OF(force_torque),

    PLACE(force_torque_config, sensors, "int"), F_REAL(slope), F_REAL(noise), F_REAL(full_scale_ratio),
    F_REAL(scale_drift), F_REAL(offset_walk), WIRE_CONFIG(force_torque_config),

    PLACE(force_torque, error, "real"), PLACE(force_torque, offset, "real"), WIRE_STATE(force_torque),

    WHOLE_OF(strain_gauges_config), WHOLE_OF(strain_gauges),

    G_INT(channels), G_INT(bends), G_INT(plays), G_INT(of_load), G_INT(creeps), G_INT(walks), G_INT(noisy),
    G_INT(converts), G_REAL(full_scale), G_REAL(creep_shares), G_REAL(creep_time_constants), G_REAL(hysteresis),
    G_REAL(hysteresis_excess), G_REAL(hysteresis_most), G_REAL(slack), G_REAL(walk_map), G_REAL(noise_map),
    G_REAL(temperature_ramp), G_REAL(temperature_rise), G_REAL(lowest), G_REAL(highest),

    H_REAL(response), H_REAL(tempco), H_REAL(offset), H_REAL(temperature), H_REAL(creep_yielded),
    H_REAL(hysteresis_plays), H_REAL(bend_cubic), H_REAL(bend_cross),

    WHOLE_OF(faults_config), WHOLE_OF(faults),

    B_INT(channels), B_INT(count), B_INT(kind), B_INT(channel), B_INT(other), B_INT(rounds), B_REAL(start),
    B_REAL(stop), B_REAL(unloaded), B_REAL(lowest), B_REAL(highest), B_REAL(rate), B_REAL(size),
    B_REAL(probability), B_REAL(burst), PLACE(faults, time, "double"), PLACE(faults, held, "real"),
    PLACE(faults, lost, "real"),

    WHOLE_OF(telemetry_config), WHOLE_OF(telemetry),

    T_INT(joints), T_INT(substeps), T_INT(before_start), T_INT(room), T_INT(averaged), T_INT(skewed), T_DOUBLE(dt),
    T_DOUBLE(substep), T_DOUBLE(period), T_DOUBLE(delay), T_DOUBLE(jitter), T_REAL(interval),
    T_REAL(smoothing), T_REAL(encoders_bias_std), T_REAL(encoders_noise_std), T_REAL(encoders_resolution), T_REAL(bias_std),
    T_REAL(spread), T_REAL(walk), T_REAL(noise), T_REAL(step), T_REAL(most),

    U_DOUBLE(due), U_WHOLE(number), U_WHOLE(substeps), U_WHOLE(first), U_WHOLE(waiting), U_REAL(bias),
    U_REAL(matrix), U_REAL(error), U_REAL(up), U_REAL(gyroscope_bias), U_REAL(position), U_REAL(velocity),
    U_REAL(inertial), U_DOUBLE(arrival), U_REAL(ring),

    WHOLE_OF(sense_records), FEET(cells_config, "word"), FEET(cells, "word"), FEET(cells_stream, "word"),
    FEET(force_torque_config, "word"), FEET(force_torque, "word"), FEET(force_torque_stream, "word"),
    FEET(faults_config, "word"), FEET(faults, "word"), FEET(faults_stream, "word"), FEET(order, "word"),
    FEET(dt, "double"), FEET(first, "double"), FEET(more, "int"),
    R_AT(map), R_AT(preload), R_AT(wrench), R_AT(load), R_AT(telemetry), R_AT(telemetry_state),
    R_AT(telemetry_stream), R_AT(newest), R_AT(raw), R_AT(observed), R_AT(low), R_AT(high), R_AT(shown),
    R_AT(held), R_AT(counts), R_AT(from), R_AT(to), R_INT(rows), R_INT(columns),
    R_INT(at_joints), R_INT(at_inertial), R_INT(at_ankles), R_INT(at_cells), R_INT(stride), R_INT(readings),
    R_INT(soles), R_INT(channels), R_INT(values), R_INT(numbers), R_INT(shares), R_INT(averaged), R_INT(packets),
};
/* clang-format on */

LIBRARY_OF(places)

EXPORTED void surefoot_philox(const uint32_t *counter, const uint32_t *key, uint32_t *word) {
    sf_philox(counter, key, word);
}

EXPORTED void surefoot_draw(sf_random *stream, int normal, int n, sf_real *out) {
    sf_random_fill(stream, normal, n, out);
}

EXPORTED int surefoot_cells_fits(const sf_cells_config *config) { return sf_cells_fits(config); }
EXPORTED void surefoot_cells_step(const sf_cells_config *config, sf_cells *cells, sf_random *stream,
                                  const sf_real *block, int substeps, double dt, sf_real *counts) {
    sf_cells_step(config, cells, stream, block, substeps, (sf_real)dt, counts);
}

/* Devices that are read at an instant take the last row of a block. */
EXPORTED int surefoot_force_torque_fits(const sf_force_torque_config *config) {
    return sf_force_torque_fits(config);
}
EXPORTED void surefoot_force_torque_step(const sf_force_torque_config *config, sf_force_torque *sensors,
                                         sf_random *stream, const sf_real *block, int rows, double dt,
                                         sf_real *counts) {
    sf_force_torque_step(config, sensors, stream, block + (rows - 1) * SF_AXES * config->sensors, (sf_real)dt,
                         counts);
}
EXPORTED int surefoot_strain_gauges_fits(const sf_strain_gauges_config *config) {
    return sf_strain_gauges_fits(config);
}
EXPORTED void surefoot_strain_gauges_step(const sf_strain_gauges_config *config, sf_strain_gauges *sensor,
                                          sf_random *stream, const sf_real *block, int rows, double dt,
                                          sf_real *counts) {
    sf_strain_gauges_step(config, sensor, stream, block + (rows - 1) * SF_AXES, (sf_real)dt, counts);
}

/* Faults take counts for loads. */
EXPORTED int surefoot_faults_fits(const sf_faults_config *config) { return sf_faults_fits(config); }
EXPORTED void surefoot_faults_step(const sf_faults_config *config, sf_faults *faults, sf_random *stream,
                                   const sf_real *block, int rows, double dt, sf_real *counts) {
    memcpy(counts, block + (rows - 1) * config->channels, (size_t)config->channels * sizeof *counts);
    sf_faults_step(config, faults, stream, (sf_real)dt, counts);
}

EXPORTED int surefoot_telemetry_fits(const sf_telemetry_config *config) { return sf_telemetry_fits(config); }
/* Both return how many packets have arrived; -1, with nothing done, if there is no room for those of the step. */
EXPORTED int surefoot_telemetry_init(const telemetry_arrays *at, sf_telemetry *state, sf_random *stream,
                                     int fresh) {
    return sf_telemetry_init(at->config, state, at->position, at->inertial, fresh, stream, at->arrived);
}
EXPORTED int surefoot_telemetry_advance(const telemetry_arrays *at, sf_telemetry *state, sf_random *stream,
                                        double time) {
    return sf_telemetry_advance(at->config, state, at->position, at->inertial, time, stream, at->arrived);
}

/* RawView.show: the newest packet in place of what is measured, and counts, of which the last ones are held. */
static void show_raw(const sf_sense_records *at) {
    memcpy(at->shown, at->observed, (size_t)at->numbers * sizeof(float));
    for (int i = 0; i < at->shares; i++) at->shown[at->to[i]] = (float)at->newest[at->from[i]];
    for (int i = 0; i < at->numbers; i++) {
        float bounded = at->shown[i] < at->low[i] ? at->low[i] : at->shown[i];
        at->shown[i] = bounded > at->high[i] ? at->high[i] : bounded;
    }
    for (int i = 0; i < at->channels; i++) {
        float count = (float)at->raw[i];
        at->counts[i] = at->held[i] = isnan(count) ? at->held[i] : count;
    }
}

/* The wrench of the ground at and in the frame of a sole, of what the simulator reads of a foot behind its ankle:
   force and torque on the ground, the place at which they act, the sole's origin and its axes, in the world. */
static void find_wrench(const sf_real *foot, sf_real *wrench) {
    const sf_real *place = foot + 6, *origin = foot + 9, *axes = foot + 12;
    sf_real force[3], moment[3], arm[3];
    for (int i = 0; i < 3; i++) {
        force[i] = -foot[i];
        arm[i] = place[i] - origin[i];
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        moment[i] = arm[j] * force[k] - arm[k] * force[j] - foot[3 + i];
    }
    for (int i = 0; i < 3; i++) {
        const sf_real *axis = axes + 3 * i;
        wrench[i] = axis[0] * force[0] + axis[1] * force[1] + axis[2] * force[2];
        wrench[3 + i] = axis[0] * moment[0] + axis[1] * moment[1] + axis[2] * moment[2];
    }
}

static void find_load(const sf_sense_records *at, const sf_real *truth) {
    int K = sf_loads(at->feet.cells_config);
    sf_real wrench[SF_AXES * SF_LOAD_CELLS];
    for (int row = 0; row < at->rows; row++) {
        const sf_real *felt = truth + row * at->columns + at->at_cells;
        sf_real *load = at->load + row * K;
        for (int foot = 0; foot < at->soles; foot++)
            find_wrench(felt + foot * at->stride, wrench + SF_AXES * foot);
        if (at->soles) felt = wrench;
        memset(load, 0, (size_t)K * sizeof(sf_real));
        for (int i = 0; i < at->readings; i++)
            for (int k = 0; k < K; k++) load[k] += felt[i] * at->map[i * K + k];
        for (int k = 0; k < K; k++) load[k] += at->preload[k];
    }
}

/* What the sensors in the ankles feel, on average or at the end: the opposite of what the simulator reads there. */
static void find_wrenches(const sf_sense_records *at, const sf_real *truth) {
    int first = at->averaged ? 0 : at->rows - 1;
    for (int foot = 0; foot < at->feet.force_torque_config->sensors; foot++)
        for (int i = 0; i < SF_AXES; i++) {
            sf_real sum = 0;
            for (int row = first; row < at->rows; row++)
                sum += truth[row * at->columns + at->at_ankles + foot * at->stride + i];
            at->wrench[SF_AXES * foot + i] = -sum / (at->rows - first);
        }
}

static void find_motion(const sf_sense_records *at, const sf_real *truth) {
    int joints = at->telemetry->config->joints;
    for (int row = 0; row < at->rows; row++) {
        const sf_real *now = truth + row * at->columns;
        memcpy(at->telemetry->position + row * joints, now + at->at_joints, (size_t)joints * sizeof *now);
        memcpy(at->telemetry->inertial + row * SF_AXES, now + at->at_inertial, SF_AXES * sizeof *now);
    }
}

/* A control step of one robot, or the start of an episode, for which 1 keeps the telemetry's sensors and 2 draws them,
   at rest as the first row of position and inertial says; and what is seen of it. truth is what the simulator reads in
   each substep. Returns what surefoot_telemetry_advance does. */
EXPORTED int surefoot_sense(sf_sense_records *at, const sf_real *truth, double time, int begins) {
    at->packets = 0;
    if (!begins && at->telemetry && sf_telemetry_coming(at->telemetry->config, at->telemetry_state) < 0) return -1;
    if (at->feet.cells_config) find_load(at, truth);
    if (at->feet.force_torque_config) find_wrenches(at, truth);
    if (begins)
        sf_feet_begin(&at->feet, at->load, at->rows, at->wrench, at->raw);
    else
        sf_feet_step(&at->feet, at->load, at->rows, at->wrench, at->raw);
    if (at->telemetry && begins)
        at->packets = surefoot_telemetry_init(at->telemetry, at->telemetry_state, at->telemetry_stream, begins - 1);
    else if (at->telemetry) {
        find_motion(at, truth);
        at->packets = surefoot_telemetry_advance(at->telemetry, at->telemetry_state, at->telemetry_stream, time);
    }
    if (at->packets > 0) {
        const sf_real *last = at->telemetry->arrived + (at->packets - 1) * (2 + at->values);
        memcpy(at->newest, last + 2, (size_t)at->values * sizeof(sf_real));
    }
    show_raw(at);
    return at->packets;
}

/* A control step of many robots, each argument with a number of each; packets[i] is what surefoot_sense returns of it.
 */
EXPORTED void surefoot_sense_many(sf_sense_records *const *at, const sf_real *const *truth, const double *time,
                                  int *packets, int count) {
    for (int i = 0; i < count; i++) packets[i] = surefoot_sense(at[i], truth[i], time[i], 0);
}
