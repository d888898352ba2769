/* The headers beside it as a shared library, with a table of where their records' fields lie. */

#include "surefoot_view.h"

#include "library.h"

#define C_INT(field) PLACE(config, field, "int")
#define C_REAL(field) PLACE(config, field, "real")
#define S_REAL(field) PLACE(state, field, "real")
#define S_WHOLE(field) PLACE(state, field, "whole")
#define R_REAL(field) PLACE(reference, field, "real")
#define E_REAL(field) PLACE(estimate, field, "real")
#define M_REAL(field) PLACE(model, field, "real")
#define B_REAL(field) PLACE(beliefs, field, "real")
#define B_WHOLE(field) PLACE(beliefs, field, "whole")
#define SHOWN(field) PLACE(shown, field, "single")
#define R_AT(field) PLACE(sample_records, field, "word")
#define IN_REFERENCE(field, kind)                                                                            \
    {"belief", #field, kind, offsetof(sf_belief, reference.field), sizeof(((sf_reference *)0)->field)}

/* What a sample tells, side by side, for a copy of all of it in one piece. */
typedef struct {
    sf_belief belief;
    sf_estimate estimate;
    sf_shown shown;
    sf_real covariance[4 * SF_CHANNELS * SF_CHANNELS];
} sf_told;

/* Records that stay where they are, so that a call has few arguments: each costs as much as a sensor. */
typedef struct {
    const sf_model *model;
    const sf_timing *timing;
    sf_beliefs *beliefs;
    sf_belief *belief;
    const unsigned char *planned;
    const sf_config *config;
    sf_state *state;
    const sf_real *raw;
    sf_estimate *estimate;
    const sf_view *view;
    sf_held *held;
    sf_told *told;
    double dt;
} sf_sample_records;

/* clang-format off */
static const place places[] = {
    WHOLE_OF(config), WHOLE_OF(state), WHOLE_OF(reference), WHOLE_OF(estimate), WHOLE_OF(work),
    PLACE(work, newton, ""), PLACE(work, rows, ""), PLACE(work, covariance, "real"), PLACE(work, part, ""),

    C_INT(channels), C_INT(feet), C_INT(lag), C_INT(every), C_INT(average), C_INT(settle), C_INT(kinds),
    C_INT(sensors), C_INT(parities), C_INT(pairs), C_INT(keep_every),
    C_INT(distal_matters), C_INT(foot_of_channel), C_INT(cells), C_INT(together), C_INT(first),
    C_INT(second), C_INT(foot_of_sensor), C_REAL(dt), C_REAL(weight), C_REAL(mass), C_REAL(length),
    C_REAL(reach), C_REAL(force_threshold), C_REAL(scale), C_REAL(offset), C_REAL(lowest),
    C_REAL(highest), C_REAL(wrench_map), C_REAL(unit), C_REAL(start), C_REAL(first_variance),
    C_REAL(walk), C_REAL(learnt), C_REAL(sure), C_REAL(change), C_REAL(aged), C_REAL(stated), C_REAL(row_scale),
    C_REAL(row_variance), C_REAL(timing_noise), C_REAL(gate), C_REAL(reject), C_REAL(still),
    C_REAL(mass_change), C_REAL(swing_noise), C_REAL(swing_load), C_REAL(parity_noise),
    C_REAL(parity), C_REAL(leap), C_REAL(renewal), C_REAL(prior), C_REAL(load_largest),
    C_REAL(load_loose), C_REAL(sensor_mass), C_REAL(sensor_com), C_REAL(sensor_share), C_REAL(felt),
    C_REAL(curve_every), C_REAL(curve_span),

    S_REAL(raw), S_REAL(history), S_REAL(motion), S_WHOLE(known), S_WHOLE(clean), S_WHOLE(step),
    S_REAL(pending), S_REAL(mean), S_REAL(covariance), S_REAL(drift), S_REAL(given),
    S_REAL(given_covariance), S_REAL(learnt), S_REAL(spread), S_REAL(kept_mean), S_REAL(kept_covariance),
    S_REAL(noise), S_REAL(misfit), S_REAL(unproven), S_REAL(quiet), S_REAL(anchor), S_WHOLE(status),
    S_REAL(last), S_WHOLE(leaps), S_REAL(leapt), S_REAL(trust), S_REAL(doubt), S_REAL(scores),
    S_REAL(size), S_REAL(load), S_REAL(moments), S_REAL(lost), S_WHOLE(kind), S_REAL(wiring),
    S_REAL(spare), S_REAL(spare_std), S_REAL(agreed), S_WHOLE(altered),

    R_REAL(com), R_REAL(com_acceleration), R_REAL(angular_momentum_rate), R_REAL(position_sole),
    R_REAL(R_level_sole), PLACE(reference, stance, "byte"), PLACE(reference, swing, "byte"),

    E_REAL(force), E_REAL(wrench), E_REAL(vgrf), E_REAL(cop), E_REAL(cop_foot), E_REAL(scale),
    E_REAL(offset), E_REAL(force_std), E_REAL(cop_covariance), E_REAL(nis), E_REAL(nis_rows),
    PLACE(estimate, flags, "whole"), PLACE(estimate, cop_valid, "byte"), PLACE(estimate, cop_foot_valid,
    "byte"),

    WHOLE_OF(model), WHOLE_OF(timing), WHOLE_OF(beliefs), WHOLE_OF(belief),

    PLACE(model, bodies, "int"), PLACE(model, hinges, "int"), PLACE(model, parent, "int"),
    PLACE(model, hinge_body, "int"), PLACE(model, site_body, "int"), M_REAL(place), M_REAL(R_parent_body),
    M_REAL(anchor), M_REAL(axis), M_REAL(zero), M_REAL(mass), M_REAL(com), M_REAL(inertia),
    M_REAL(position_site), M_REAL(R_body_site),

    PLACE(timing, averaged, "int"), PLACE(timing, needed, "int"), PLACE(timing, window, "int"),
    PLACE(timing, dt, "real"), PLACE(timing, period, "double"), PLACE(timing, delay, "double"),

    B_REAL(ring), B_REAL(angle), B_REAL(accelerometer), B_REAL(gyroscope), B_REAL(forward), B_REAL(up),
    B_REAL(spin), B_REAL(spin_bias), B_REAL(force_bias), B_REAL(lean), B_REAL(highest),
    PLACE(beliefs, clock, "double"), B_WHOLE(number), B_WHOLE(seen), B_WHOLE(run), B_WHOLE(count),
    B_WHOLE(planned), B_WHOLE(found), B_WHOLE(upright),

    IN_REFERENCE(com, "real"), IN_REFERENCE(com_acceleration, "real"),
    IN_REFERENCE(angular_momentum_rate, "real"), IN_REFERENCE(position_sole, "real"),
    IN_REFERENCE(R_level_sole, "real"), IN_REFERENCE(stance, "byte"), IN_REFERENCE(swing, "byte"),
    PLACE(belief, accelerometer, "real"), PLACE(belief, gyroscope, "real"), PLACE(belief, known, "byte"),
    PLACE(belief, fell, "byte"),

    WHOLE_OF(view), WHOLE_OF(shown),

    PLACE(view, force_bound, "real"), PLACE(view, cop_bound, "real"), PLACE(view, weight, "real"),
    PLACE(view, flawed, "int"),

    SHOWN(foot_force), SHOWN(foot_load), SHOWN(cop_foot), SHOWN(cop), SHOWN(wrench), SHOWN(vgrf),
    SHOWN(foot_force_std), SHOWN(cop_std), PLACE(shown, foot_flags, "int"),
    PLACE(shown, cop_valid, "small"),

    WHOLE_OF(told), {"told", "belief", "", offsetof(sf_told, belief), sizeof(sf_belief)},
    {"told", "estimate", "", offsetof(sf_told, estimate), sizeof(sf_estimate)},
    {"told", "shown", "", offsetof(sf_told, shown), sizeof(sf_shown)}, PLACE(told, covariance, "real"),

    WHOLE_OF(sample_records), R_AT(model), R_AT(timing), R_AT(beliefs), R_AT(belief), R_AT(planned),
    R_AT(config), R_AT(state), R_AT(raw), R_AT(estimate), R_AT(view), R_AT(held), R_AT(told),
    PLACE(sample_records, dt, "double"),
};
/* clang-format on */

LIBRARY_OF(places)

EXPORTED int surefoot_fits(const sf_config *config) { return sf_calibrator_fits(config); }
EXPORTED void surefoot_init(const sf_config *config, sf_state *state) { sf_calibrator_init(config, state); }
EXPORTED void surefoot_retract(const sf_config *config, sf_state *state) {
    sf_calibrator_retract(config, state);
}
EXPORTED void surefoot_step(const sf_config *config, sf_state *state, const sf_real *raw,
                            const sf_reference *reference, double dt, sf_estimate *estimate) {
    sf_calibrator_step(config, state, raw, reference, (sf_real)dt, estimate);
}

EXPORTED int surefoot_beliefs_fit(const sf_model *model, const sf_timing *timing) {
    return sf_beliefs_fit(model, timing);
}
/* rows: of each packet its number, its arrival and its values as wrappers.telemetry.TelemetryLayout has them.
 */
EXPORTED void surefoot_beliefs_packets(const sf_model *model, const sf_timing *timing, sf_beliefs *beliefs,
                                       const double *rows, int count) {
    int hinges = model->hinges, size = 2 * hinges + 8;
    for (const double *row = rows; count > 0; count--, row += 2 + size) {
        sf_real values[2 * SF_HINGES + 8], *gyroscope = values + 2 * hinges + 2;
        for (int i = 0; i < size; i++) values[i] = (sf_real)row[2 + i];
        if (sf_measured(values, size))
            sf_beliefs_packet(model, timing, beliefs, (sf_whole)row[0], row[1], values, gyroscope + 3,
                              gyroscope);
    }
}
/* Returns 1 for a robot that fell, plus 2 if the reference is known, plus 4 if a foot stands by it. */
EXPORTED int surefoot_beliefs_sample(const sf_timing *timing, sf_beliefs *beliefs, double time,
                                     const unsigned char *planned, int hold, sf_belief *belief) {
    sf_beliefs_sample(timing, beliefs, time, planned, hold, belief);
    return belief->fell + 2 * belief->known +
           4 * (belief->reference.stance[0] || belief->reference.stance[1]);
}
EXPORTED void surefoot_beliefs_reference(const sf_timing *timing, sf_beliefs *beliefs, double time,
                                         sf_belief *belief) {
    sf_beliefs_reference(timing, beliefs, time, belief);
}
EXPORTED void surefoot_beliefs_soles(const sf_timing *timing, sf_beliefs *beliefs, double time,
                                     sf_real *soles) {
    sf_beliefs_soles(timing, beliefs, time, soles);
}

EXPORTED void surefoot_view_show(const sf_config *config, const sf_view *view, sf_held *held,
                                 const sf_estimate *estimate, const sf_real *soles, sf_shown *shown) {
    sf_view_show(config, view, held, estimate, soles, shown);
}

/* All of one sample: packets that have arrived, beliefs, filter and view. how: 1 if `planned` is one, plus 2 to
   learn nothing. Returns what surefoot_beliefs_sample does, plus 8 if something was learnt. */
EXPORTED int surefoot_sample(const sf_sample_records *at, const double *rows, int count, double time, double now,
                             int how) {
    sf_told *told = at->told;
    sf_real soles[8];
    if (count) surefoot_beliefs_packets(at->model, at->timing, at->beliefs, rows, count);
    int found = surefoot_beliefs_sample(at->timing, at->beliefs, time, how & 1 ? at->planned : NULL, how & 2,
                                        at->belief);
    if (found & 1) sf_calibrator_retract(at->config, at->state);
    sf_calibrator_step(at->config, at->state, at->raw, &at->belief->reference, (sf_real)at->dt, at->estimate);
    sf_beliefs_soles(at->timing, at->beliefs, now, soles);
    sf_view_show(at->config, at->view, at->held, at->estimate, soles, &told->shown);
    told->belief = *at->belief;
    told->estimate = *at->estimate;
    memcpy(told->covariance, at->state->learnt,
           sizeof(sf_real) * (size_t)(4 * at->config->channels * at->config->channels));
    return found + 8 * !isnan(at->estimate->nis);
}
