/* Calibrators and beliefs as a shared library, with a table of where their records' fields lie. */

#include "surefoot_moment.h"
#include "surefoot_strapdown.h"
#include "surefoot_view.h"
#include "surefoot_window.h"

#include "library.h"

#define C_INT(field) PLACE(config, field, "int")
#define C_REAL(field) PLACE(config, field, "real")
/* A field of a part of a record, under a name of its own: in a state the way to it. */
#define PART(record, name, field, kind)                                                                      \
    {#record, #name, kind, offsetof(sf_##record, field), sizeof(((sf_##record *)0)->field)}
/* What a state holds of the way of a sample, and of channels' faults. */
#define FRONT_OF(record)                                                                                     \
    PART(record, front_raw, front.raw, "real"), PART(record, front_history, front.history, "real"),          \
        PART(record, front_motion, front.motion, "real"), PART(record, front_known, front.known, "whole"),   \
        PART(record, front_clean, front.clean, "whole")
#define FAULTS_OF(record)                                                                                    \
    PART(record, faults_last, faults.last, "real"), PART(record, faults_leaps, faults.leaps, "whole"),       \
        PART(record, faults_leapt, faults.leapt, "real"), PART(record, faults_landed, faults.landed, "real"),   \
        PART(record, faults_moments, faults.moments, "real"), \
        PART(record, faults_lost, faults.lost, "real"), PART(record, faults_kind, faults.kind, "whole"),     \
        PART(record, faults_wiring, faults.wiring, "real"), PART(record, faults_spare, faults.spare, "real"), \
        PART(record, faults_spare_std, faults.spare_std, "real"),                                            \
        PART(record, faults_agreed, faults.agreed, "real"), PART(record, faults_level, faults.level, "real"),   \
        PART(record, faults_shown, faults.shown, "real"),                                                    \
        PART(record, faults_expected, faults.expected, "real"), PART(record, faults_alive, faults.alive, "real"),\
        PART(record, faults_missed, faults.missed, "real"),                                                  \
        PART(record, faults_offered, faults.offered, "real"),                                                \
        PART(record, faults_altered, faults.altered, "whole")
#define W_INT(field) PLACE(window_config, field, "int")
#define W_REAL(field) PLACE(window_config, field, "real")
#define W_DOUBLE(field) PLACE(window_config, field, "double")
#define V_REAL(field) PLACE(window_state, field, "real")
#define V_WHOLE(field) PLACE(window_state, field, "whole")
#define STANDING(field, kind) PART(window_state, standing_##field, standing.field, kind)
#define O_REAL(field) PLACE(moment_config, field, "real")
#define N_REAL(field) PLACE(moment_state, field, "real")
#define IN(name, field, kind) PART(moment_state, name, field, kind)
/* What modes hold, and what is handed out. */
#define KNOWN(name, belief, published)                                                                       \
    IN(name##belief_mean, belief.mean, "real"), IN(name##belief_covariance, belief.covariance, "real"),      \
        IN(name##belief_chance, belief.chance, "real"), IN(name##published_mean, published.mean, "real"),    \
        IN(name##published_covariance, published.covariance, "real"),                                        \
        IN(name##published_undetermined, published.undetermined, "real")
#define T_REAL(field) PLACE(tare_state, field, "real")
#define R_REAL(field) PLACE(reference, field, "real")
#define E_REAL(field) PLACE(estimate, field, "real")
#define M_REAL(field) PLACE(model, field, "real")
#define SHOWN(field) PLACE(shown, field, "single")
#define R_AT(field) PLACE(sample_records, field, "word")
#define IN_REFERENCE(field, kind)                                                                            \
    PART(belief, field, reference.field, kind)
#define IN_MOMENTUM(name, field, kind)                                                                       \
    {"momentum_belief", #name, kind, offsetof(sf_belief, field), sizeof(((sf_belief *)0)->field)}

/* What a sample tells, side by side, for a copy of all of it in one piece. */
typedef struct {
    sf_belief belief;
    sf_estimate estimate;
    sf_shown shown;
    sf_real covariance[4 * SF_CHANNELS * SF_CHANNELS];
} sf_told;

/* How one robot is calibrated: its constants, those of a method, and which one that is. */
enum { MOMENT, WINDOW, TARE, UNCORRECTED };
typedef struct {
    const sf_config *config;
    const void *own;
    sf_whole method;
} sf_filter;

/* Records that stay where they are, so that a call has few arguments: each costs as much as a sensor. */
typedef struct {
    const sf_model *model;
    const sf_timing *timing;
    sf_beliefs *beliefs; /* the first of sf_momentum_beliefs, or not */
    sf_belief *belief;
    const unsigned char *planned;
    const sf_filter *filter;
    void *state;
    const sf_real *raw;
    sf_estimate *estimate;
    const sf_view *view;
    sf_held *held;
    sf_told *told;
    sf_whole *counts; /* as of robot/chances.py */
    double dt;
    sf_whole momentum;
} sf_sample_records;
enum { WAITING, SAMPLES, UPRIGHT, STANDING, RUN, LONGEST };

/* clang-format off */
static const place places[] = {
    WHOLE_OF(config), WHOLE_OF(reference), WHOLE_OF(estimate),

    C_INT(channels), C_INT(feet), C_INT(lag), C_INT(kept), C_INT(foot_of_channel), C_INT(cells), C_INT(together),
    C_REAL(dt), C_REAL(weight), C_REAL(mass), C_REAL(gravity), C_REAL(length), C_REAL(reach), C_REAL(force_threshold),
    C_REAL(carried), C_REAL(scale), C_REAL(offset), C_REAL(lowest), C_REAL(highest), C_REAL(wrench_map), C_REAL(leap),
    C_REAL(leap_alone), C_REAL(landing_kept),
    C_REAL(renewal), C_REAL(prior), C_REAL(by_others),

    WHOLE_OF(filter), PLACE(filter, config, "word"), PLACE(filter, own, "word"),
    PLACE(filter, method, "whole"), WHOLE_OF(window_config), WHOLE_OF(window_state), WHOLE_OF(window_work),
    WHOLE_OF(tare_config), WHOLE_OF(tare_state), WHOLE_OF(front),

    W_INT(every), W_INT(length), W_INT(settle), W_INT(transition), W_INT(iterations), W_INT(quasi_static),
    W_INT(filtered), W_INT(standing_start), W_INT(standing_samples), W_REAL(force), W_REAL(cop),
    W_REAL(gross_force), W_REAL(gross_length), W_REAL(outlier), W_REAL(least), W_REAL(spread),
    W_REAL(step_bound), W_REAL(rate_bound), W_REAL(lowest), W_REAL(highest), W_REAL(transfer), W_REAL(steady),
    W_DOUBLE(warm_up), W_DOUBLE(duration), W_DOUBLE(patience), W_REAL(deviation), W_REAL(noise),
    W_REAL(shared), W_REAL(largest), W_REAL(acceleration_threshold), W_REAL(rate_threshold),

    FRONT_OF(window_state), V_WHOLE(step), V_REAL(pending), V_REAL(filter), V_REAL(latest), V_WHOLE(started),
    V_WHOLE(contact), V_WHOLE(since_change), V_REAL(samples), V_REAL(theta), V_WHOLE(status),
    V_WHOLE(walking), V_WHOLE(all_walking), STANDING(time, "double"), STANDING(samples, "whole"),
    STANDING(dropped, "whole"), STANDING(gated, "whole"), STANDING(information, "real"),
    STANDING(gradient, "real"), STANDING(energy, "real"),

    PLACE(window_work, A, "real"), PLACE(window_work, J, "real"), PLACE(window_work, gradient, "real"),
    PLACE(window_work, theta, "real"), PLACE(window_work, use, "real"), PLACE(window_work, square, "real"),
    PLACE(window_work, ordered, "real"),

    PLACE(tare_config, settle, "int"), PLACE(tare_config, minimum_samples, "int"),
    PLACE(tare_config, spread, "real"), PLACE(tare_config, limit, "real"), FRONT_OF(tare_state),
    PLACE(tare_state, airborne, "whole"), PLACE(tare_state, count, "whole"), T_REAL(mean), T_REAL(scatter),
    T_REAL(offset),

    WHOLE_OF(moment_config), WHOLE_OF(moment_state), WHOLE_OF(moment_work),
    {"moment_work", "numbers", "", 0, sizeof(sf_moment_work)}, /* of which nobody reads one */

    PLACE(moment_config, components, "int"), PLACE(moment_config, capacity, "int"),
    PLACE(moment_config, held, "int"), PLACE(moment_config, talks, "int"), PLACE(moment_config, talk_to, "int"),
    PLACE(moment_config, talk_from, "int"), O_REAL(first_variance), O_REAL(walk), O_REAL(block), O_REAL(mass_std), O_REAL(ahead),
    O_REAL(kept_time), O_REAL(longest_pause), O_REAL(product_time), O_REAL(largest_error), O_REAL(level), O_REAL(least_read), O_REAL(held_chance),
    O_REAL(velocity_variance), O_REAL(spin_variance), O_REAL(ripple), O_REAL(least_load), O_REAL(tare_variance),
    O_REAL(tare_share), O_REAL(least_apart), O_REAL(rate_share), O_REAL(smallest_rate),
    O_REAL(largest_rate), O_REAL(tare_surprise), O_REAL(stated_rate), O_REAL(first_rate), O_REAL(tare_leap), O_REAL(largest_load), O_REAL(largest_tared),
    O_REAL(largest_sum), O_REAL(touch_load), O_REAL(spread_scale), O_REAL(spread_offset), O_REAL(unit),
    O_REAL(severities), O_REAL(likely), O_REAL(wide), O_REAL(least_share), O_REAL(most_load),
    O_REAL(least_row), O_REAL(reading_noise), O_REAL(mode_time), O_REAL(mode_force), O_REAL(mode_torque),
    O_REAL(mode_load), O_REAL(mode_shift), O_REAL(rates), O_REAL(first_chance), O_REAL(least_chance),
    O_REAL(leg_time), O_REAL(spin_time), O_REAL(first_speed), O_REAL(fastest),
    O_REAL(sure), O_REAL(contrast), O_REAL(alike), O_REAL(smallest_step), O_REAL(least_error), O_REAL(suspect_share), O_REAL(suspect_noise), O_REAL(suspect_surprise),

    FRONT_OF(moment_state), IN(track_motion, track.motion, "real"), IN(track_samples, track.samples, "whole"),
    IN(track_heading, track.heading, "real"), IN(track_origin, track.origin, "real"),
    IN(track_velocity, track.velocity, "real"), IN(track_spin, track.spin, "real"),
    IN(track_adrift, track.adrift, "real"), FAULTS_OF(moment_state),
    N_REAL(pending), N_REAL(before), PLACE(moment_state, waiting, "whole"), PLACE(moment_state, linked, "whole"),
    N_REAL(point), N_REAL(time), N_REAL(drifted), IN(tare_reading, tare.reading, "real"),
    IN(tare_centre, tare.centre, "real"), IN(tare_time, tare.time, "real"), IN(tare_rate, tare.rate, "real"),
    IN(tare_followed, tare.followed, "whole"), IN(suspects_score, suspects.score, "real"),
    IN(suspects_before, suspects.before, "real"), IN(suspects_error, suspects.error, "real"),
    IN(suspects_noise, suspects.noise, "real"), IN(suspects_known, suspects.known, "real"),
    IN(suspects_force, suspects.force, "real"), N_REAL(shift), KNOWN(, belief, published), N_REAL(covariance),
    KNOWN(kept_, kept.belief, kept.published), KNOWN(kept_next_, next.belief, next.published),
    IN(kept_age, age, "real"), PLACE(moment_state, status, "whole"),

    PLACE(front, raw, "real"), PLACE(front, history, "real"), PLACE(front, motion, "real"),
    PLACE(front, known, "whole"), PLACE(front, clean, "whole"),

    R_REAL(com), R_REAL(com_acceleration), R_REAL(angular_momentum_rate), R_REAL(position_sole),
    R_REAL(R_level_sole), PLACE(reference, stance, "byte"), PLACE(reference, swing, "byte"),
    PLACE(reference, momentum, "byte"),

    E_REAL(force), E_REAL(wrench), E_REAL(vgrf), E_REAL(cop), E_REAL(cop_measured), E_REAL(cop_foot), E_REAL(scale),
    E_REAL(offset), E_REAL(force_std), E_REAL(cop_covariance), E_REAL(nis), E_REAL(nis_rows),
    E_REAL(undetermined), E_REAL(contact_probability),
    PLACE(estimate, flags, "whole"), PLACE(estimate, cop_valid, "byte"), PLACE(estimate, cop_foot_valid,
    "byte"),

    WHOLE_OF(model), WHOLE_OF(timing), WHOLE_OF(beliefs), WHOLE_OF(belief),

    PLACE(model, bodies, "int"), PLACE(model, hinges, "int"), PLACE(model, parent, "int"),
    PLACE(model, hinge_body, "int"), PLACE(model, site_body, "int"), M_REAL(place), M_REAL(R_parent_body),
    M_REAL(anchor), M_REAL(axis), M_REAL(zero), M_REAL(mass), M_REAL(com), M_REAL(inertia),
    M_REAL(position_site), M_REAL(R_body_site),

    PLACE(timing, averaged, "int"), PLACE(timing, joined, "int"), PLACE(timing, needed, "int"),
    PLACE(timing, window, "int"), PLACE(timing, feet, "int"), PLACE(timing, points, "int"), PLACE(timing, rolls, "int"),
    PLACE(timing, dt, "real"), PLACE(timing, gravity, "real"), PLACE(timing, leg_time, "real"),
    PLACE(timing, tilt_rate, "real"), PLACE(timing, zero_offset, "real"), PLACE(timing, bias_time, "real"),
    PLACE(timing, touch, "real"), PLACE(timing, corners, "real"), PLACE(timing, radius, "real"),
    PLACE(timing, period, "double"), PLACE(timing, delay, "double"),

    WHOLE_OF(momentum_beliefs),

    IN_REFERENCE(com, "real"), IN_REFERENCE(com_acceleration, "real"),
    IN_REFERENCE(angular_momentum_rate, "real"), IN_REFERENCE(position_sole, "real"),
    IN_REFERENCE(R_level_sole, "real"), IN_REFERENCE(stance, "byte"), IN_REFERENCE(swing, "byte"),
    IN_REFERENCE(momentum, "byte"),
    PLACE(belief, accelerometer, "real"), PLACE(belief, gyroscope, "real"), PLACE(belief, known, "byte"),
    PLACE(belief, fell, "byte"),

    /* The same of one that holds momentum. */
    {"momentum_belief", "", "", 0, sizeof(sf_belief)}, IN_MOMENTUM(com, reference.com, "real"),
    IN_MOMENTUM(com_velocity, reference.com_acceleration, "real"),
    IN_MOMENTUM(angular_momentum, reference.angular_momentum_rate, "real"),
    IN_MOMENTUM(position_sole, reference.position_sole, "real"),
    IN_MOMENTUM(R_level_sole, reference.R_level_sole, "real"), IN_MOMENTUM(stance, reference.stance, "byte"),
    IN_MOMENTUM(swing, reference.swing, "byte"), IN_MOMENTUM(momentum, reference.momentum, "byte"),
    IN_MOMENTUM(accelerometer, accelerometer, "real"), IN_MOMENTUM(gyroscope, gyroscope, "real"),
    IN_MOMENTUM(known, known, "byte"), IN_MOMENTUM(fell, fell, "byte"),

    WHOLE_OF(view), WHOLE_OF(shown),

    PLACE(view, force_bound, "real"), PLACE(view, cop_bound, "real"), PLACE(view, weight, "real"),
    PLACE(view, flawed, "int"), PLACE(view, rolls, "int"),

    SHOWN(foot_force), SHOWN(foot_load), SHOWN(cop_foot), SHOWN(cop), SHOWN(wrench), SHOWN(vgrf),
    SHOWN(foot_force_std), SHOWN(cop_std), SHOWN(cop_valid), SHOWN(contact_probability), SHOWN(undetermined), PLACE(shown, foot_flags, "int"),

    WHOLE_OF(told), {"told", "belief", "", offsetof(sf_told, belief), sizeof(sf_belief)},
    {"told", "estimate", "", offsetof(sf_told, estimate), sizeof(sf_estimate)},
    {"told", "shown", "", offsetof(sf_told, shown), sizeof(sf_shown)}, PLACE(told, covariance, "real"),

    WHOLE_OF(sample_records), R_AT(model), R_AT(timing), R_AT(beliefs), R_AT(belief), R_AT(planned),
    R_AT(filter), R_AT(state), R_AT(raw), R_AT(estimate), R_AT(view), R_AT(held), R_AT(told), R_AT(counts),
    PLACE(sample_records, dt, "double"), PLACE(sample_records, momentum, "whole"),
};
/* clang-format on */

LIBRARY_OF(places)

EXPORTED int surefoot_fits(const sf_filter *f) {
    return f->method == MOMENT   ? sf_moment_fits(f->config, (const sf_moment_config *)f->own)
           : f->method == WINDOW ? sf_window_fits(f->config, (const sf_window_config *)f->own)
                                 : sf_robot_fits(f->config);
}
#ifndef SF_NO_LIBC /* kernels call the headers themselves */
/* Of which nothing is remembered; too large for the stacks of some threads. */
static __thread sf_moment_work moment_work;

EXPORTED void surefoot_init(const sf_filter *f, void *state) {
    if (f->method == MOMENT) sf_moment_init(f->config, f->own, state, &moment_work);
    if (f->method == WINDOW) sf_window_init(f->config, f->own, state);
    if (f->method == TARE) sf_tare_init(f->config, state);
    if (f->method == UNCORRECTED) sf_front_init(f->config, state);
}
/* Of methods that are compared with. */
EXPORTED void surefoot_begin(const sf_filter *f, void *state) {
    if (f->method == WINDOW) sf_window_begin(f->config, state);
    if (f->method == TARE) sf_tare_begin(f->config, state);
    if (f->method == UNCORRECTED) sf_front_init(f->config, state);
}
EXPORTED void surefoot_retract(const sf_filter *f, void *state) {
    if (f->method == MOMENT) sf_moment_retract(f->config, f->own, state);
}
EXPORTED void surefoot_step(const sf_filter *f, void *state, const sf_real *raw, const sf_belief *belief,
                            double dt, sf_estimate *out) {
    const sf_reference *reference = &belief->reference;
    const sf_real *imu[] = {belief->accelerometer, belief->gyroscope};
    sf_window_work work;
    switch (f->method) {
    case MOMENT:
        sf_moment_step(f->config, f->own, state, &moment_work, raw, reference, (sf_real)dt, out);
        break;
    case WINDOW:
        sf_window_step(f->config, f->own, state, &work, raw, reference, imu, (sf_real)dt, out);
        break;
    case TARE: sf_tare_step(f->config, f->own, state, raw, reference, (sf_real)dt, out); break;
    default: sf_uncorrected_step(f->config, state, raw, reference, (sf_real)dt, out);
    }
}

EXPORTED int surefoot_beliefs_fit(const sf_model *model, const sf_timing *timing) {
    return sf_beliefs_fit(model, timing);
}
/* momentum: whether beliefs hold it, which are an sf_momentum_beliefs then. */
EXPORTED void surefoot_beliefs_init(int momentum, void *beliefs) {
    if (momentum) sf_momentum_beliefs_init(beliefs);
    else sf_beliefs_init(beliefs);
}
/* rows: of each packet its number, its arrival and its values as surefoot.robot.TelemetryLayout has them.
 */
EXPORTED void surefoot_beliefs_packets(const sf_model *model, const sf_timing *timing, int momentum, void *beliefs,
                                       const double *rows, int count) {
    int hinges = model->hinges, size = 2 * hinges + 8;
    for (const double *row = rows; count > 0; count--, row += 2 + size) {
        sf_real values[2 * SF_HINGES + 8], *gyroscope = values + 2 * hinges + 2;
        for (int i = 0; i < size; i++) values[i] = (sf_real)row[2 + i];
        if (!sf_measured(values, size)) continue;
        if (momentum)
            sf_momentum_packet(model, timing, beliefs, (sf_whole)row[0], row[1], values, gyroscope + 3, gyroscope);
        else sf_beliefs_packet(model, timing, beliefs, (sf_whole)row[0], row[1], values, gyroscope + 3, gyroscope);
    }
}
/* Returns 1 for a robot that fell, plus 2 if the reference is known, plus 4 if a foot stands by it. */
EXPORTED int surefoot_beliefs_sample(const sf_timing *timing, int momentum, void *beliefs, double time,
                                     const unsigned char *planned, int hold, sf_belief *belief) {
    int standing = 0;
    if (momentum) sf_momentum_sample(timing, beliefs, time, planned, hold, belief);
    else sf_beliefs_sample(timing, beliefs, time, planned, hold, belief);
    for (int foot = 0; foot < timing->feet; foot++) standing = standing || belief->reference.stance[foot];
    return belief->fell + 2 * belief->known + 4 * standing;
}
EXPORTED void surefoot_beliefs_reference(const sf_timing *timing, sf_beliefs *beliefs, double time,
                                         sf_belief *belief) {
    sf_beliefs_reference(timing, beliefs, time, belief);
}
EXPORTED void surefoot_beliefs_momentum(const sf_timing *timing, const sf_momentum_beliefs *beliefs, double time,
                                        sf_belief *belief) {
    sf_momentum_reference(timing, beliefs, time, belief);
}
EXPORTED void surefoot_beliefs_soles(const sf_timing *timing, sf_beliefs *beliefs, double time,
                                     sf_real *soles) {
    sf_beliefs_soles(timing, beliefs, time, soles);
}

EXPORTED void surefoot_view_show(const sf_config *config, const sf_view *view, sf_held *held,
                                 const sf_estimate *estimate, const sf_real *soles, sf_shown *shown) {
    sf_view_show(config, view, held, estimate, soles, shown);
}

/* Chances.add: count one sample, of which surefoot_beliefs_sample has found so much. */
static void count_sample(sf_whole *counts, int found) {
    int upright = (found & 2) > 0, stands = upright && found & 4;
    counts[SAMPLES]++;
    counts[UPRIGHT] += upright;
    counts[STANDING] += stands;
    counts[RUN] = stands ? counts[RUN] + 1 : 0;
    if (counts[RUN] > counts[LONGEST]) counts[LONGEST] = counts[RUN];
}

/* All of one sample: packets that have arrived, beliefs, filter and view. how: 1 if `planned` is one, plus 2 to
   learn nothing. */
EXPORTED void surefoot_sample(const sf_sample_records *at, const double *rows, int count, double time, double now,
                              int how) {
    const sf_config *config = at->filter->config;
    sf_told *told = at->told;
    sf_real soles[4 * SF_FEET];
    int hold = how & 2 || at->counts[WAITING] > 0;
    at->counts[WAITING] -= at->counts[WAITING] > 0;
    if (count) surefoot_beliefs_packets(at->model, at->timing, (int)at->momentum, at->beliefs, rows, count);
    int found = surefoot_beliefs_sample(at->timing, (int)at->momentum, at->beliefs, time,
                                        how & 1 ? at->planned : NULL, hold, at->belief);
    count_sample(at->counts, found);
    if (found & 1) surefoot_retract(at->filter, at->state);
    surefoot_step(at->filter, at->state, at->raw, at->belief, at->dt, at->estimate);
    sf_beliefs_soles(at->timing, at->beliefs, now, soles);
    sf_view_show(config, at->view, at->held, at->estimate, soles, &told->shown);
    told->belief = *at->belief;
    told->estimate = *at->estimate;
    if (at->filter->method == MOMENT)
        sf_copy(told->covariance, ((const sf_moment_state *)at->state)->covariance, 4 * config->channels * config->channels);
}

/* A sample of many robots, each argument with a number of each; readings and plans lie where they were made. */
EXPORTED void surefoot_sample_many(const sf_sample_records *const *at, const double *const *rows, const int *count,
                                   const sf_real *const *raw, const unsigned char *const *planned, const double *time,
                                   const double *now, const int *how, int robots) {
    for (int i = 0; i < robots; i++) {
        sf_sample_records one = *at[i];
        one.raw = raw[i];
        one.planned = planned[i];
        surefoot_sample(&one, rows[i], count[i], time[i], now[i], how[i]);
    }
}
#endif
