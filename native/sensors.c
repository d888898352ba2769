/* The sensors' headers as a shared library, with a table of where their records' fields lie. */

#include "surefoot_feet.h"
#include "surefoot_random.h"
#include "surefoot_telemetry.h"

#include "library.h"

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
    WHOLE_OF(random), WHOLE_OF(cells_config), WHOLE_OF(cells), WHOLE_OF(force_torque_config), WHOLE_OF(force_torque),
    WHOLE_OF(strain_gauges_config), WHOLE_OF(strain_gauges), WHOLE_OF(faults_config), WHOLE_OF(faults),
    WHOLE_OF(telemetry_config), WHOLE_OF(telemetry), WHOLE_OF(sense_records),
    FIELDS(random, "word", key, count),
    FIELDS(cells_config, "int", channels, clocked, averaged, settling, warms, shears, plays, creeps),
    FIELDS(cells_config, "real", highest_rate, slope, zero_code, noise_counts, scale_drift, offset_drift,
        temperature_ramp, temperature_rise, capacity, nonlinearity, hysteresis, hysteresis_excess, slack,
        creep_shares, creep_time_constants, impact_threshold),
    FIELDS(cells_config, "real", mounting_warp_std, mounting_common_std, overload_share, safe_load),
    PARTS(cells_config, wire_, wire., "int", bits, offset_binary, late, under_way),
    PARTS(cells_config, wire_, wire., "real", lowest, highest, spike_size, spike_rate, wrong_words, stale_repeats,
        packet_loss, packet_loss_length, gap_share, gap_length, delay, jitter),
    FIELDS(cells, "real", period, due, charge, held, error, thermal, window, mechanics_nonlinearity_quadratic,
        mechanics_hysteresis_plays, mechanics_creep_yielded, mechanics_mounting_offset, mechanics_mounting_load,
        mechanics_mounting_impact, mechanics_overload_excess, shear),
    PARTS(cells, wire_, wire., "real", stale_repeats_held, packet_loss_lost, gaps_lost, latency_due, latency_readings,
        latency_held),
    FIELDS(force_torque_config, "int", sensors),
    FIELDS(force_torque_config, "real", slope, noise, full_scale_ratio, scale_drift, offset_walk),
    PARTS(force_torque_config, wire_, wire., "int", bits, offset_binary, late, under_way),
    PARTS(force_torque_config, wire_, wire., "real", lowest, highest, spike_size, spike_rate, wrong_words,
        stale_repeats, packet_loss, packet_loss_length, gap_share, gap_length, delay, jitter),
    FIELDS(force_torque, "real", error, offset),
    PARTS(force_torque, wire_, wire., "real", stale_repeats_held, packet_loss_lost, gaps_lost, latency_due,
        latency_readings, latency_held),
    FIELDS(strain_gauges_config, "int", channels, bends, plays, creeps, walks, noisy, converts),
    FIELDS(strain_gauges_config, "real", full_scale, creep_shares, creep_time_constants, hysteresis,
        hysteresis_excess, slack, walk_map, noise_map, temperature_ramp, temperature_rise, lowest,
        highest),
    FIELDS(strain_gauges, "real", response, tempco, offset, temperature, creep_yielded, hysteresis_plays, bend_cubic,
        bend_cross),
    FIELDS(faults_config, "int", channels, count, kind, channel, other, rounds),
    FIELDS(faults_config, "real", start, stop, unloaded, lowest, highest, rate, size, probability, burst),
    FIELDS(faults, "double", time),
    FIELDS(faults, "real", held, lost),
    FIELDS(telemetry_config, "int", joints, substeps, before_start, room, averaged, skewed),
    FIELDS(telemetry_config, "double", dt, substep, period, delay, jitter),
    FIELDS(telemetry_config, "real", interval, smoothing, encoders_bias_std, encoders_noise_std, encoders_resolution,
        bias_std, spread, walk, noise, step, most),
    FIELDS(telemetry, "double", due, arrival),
    FIELDS(telemetry, "whole", number, substeps, first, waiting),
    FIELDS(telemetry, "real", bias, matrix, error, up, gyroscope_bias, position, velocity, inertial, ring),
    PARTS(sense_records, , feet., "word", cells_config, cells, cells_stream, force_torque_config, force_torque,
        force_torque_stream, faults_config, faults, faults_stream, order),
    PARTS(sense_records, , feet., "double", dt, first),
    PARTS(sense_records, , feet., "int", more),
    FIELDS(sense_records, "word", map, preload, wrench, load, telemetry, telemetry_state, telemetry_stream, newest,
        raw, observed, low, high, shown, held, counts, from),
    FIELDS(sense_records, "word", to),
    FIELDS(sense_records, "int", rows, columns, at_joints, at_inertial, at_ankles, at_cells, stride, readings, soles,
        channels, values, numbers, shares, averaged, packets),
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
