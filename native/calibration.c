/* Calibrators and beliefs as a shared library, with a table of where their records' fields lie. */

#include "surefoot_moment.h"
#include "surefoot_strapdown.h"
#include "surefoot_view.h"
#include "surefoot_tare.h"

#include "library.h"

/* What a sample tells, side by side, for a copy of all of it in one piece. */
typedef struct {
    sf_belief belief;
    sf_estimate estimate;
    sf_shown shown;
    sf_real covariance[4 * SF_CHANNELS * SF_CHANNELS];
} sf_told;

/* How one robot is calibrated: its constants, those of a method, and which one that is. */
enum { MOMENT, TARE, UNCORRECTED };
typedef struct {
    const sf_config *config;
    const void *own;
    sf_whole method;
} sf_filter;

typedef sf_belief sf_momentum_belief; /* of one that holds momentum */

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
    WHOLE_OF(config), WHOLE_OF(reference), WHOLE_OF(estimate), WHOLE_OF(filter),
    WHOLE_OF(tare_config), WHOLE_OF(tare_state), WHOLE_OF(front),
    WHOLE_OF(moment_config), WHOLE_OF(moment_state), WHOLE_OF(moment_work), WHOLE_OF(model), WHOLE_OF(timing),
    WHOLE_OF(beliefs), WHOLE_OF(belief), WHOLE_OF(momentum_beliefs), WHOLE_OF(momentum_belief), WHOLE_OF(view),
    WHOLE_OF(shown), WHOLE_OF(told), WHOLE_OF(sample_records),
    FIELDS(config, "int", channels, feet, lag, kept, aligned_lag, foot_of_channel, cells, together),
    FIELDS(config, "real", dt, weight, mass, gravity, length, reach, force_threshold, carried, scale, offset, lowest,
        highest, wrench_map, leap, leap_alone),
    FIELDS(config, "real", age, renewal, prior, by_others, longest_silence),
    FIELDS(reference, "real", com, com_acceleration, angular_momentum_rate, position_sole, R_level_sole),
    FIELDS(reference, "byte", stance, swing, momentum),
    FIELDS(estimate, "real", force, wrench, vgrf, cop, cop_measured, cop_foot, scale, offset, force_std,
        cop_covariance, nis, nis_rows, undetermined, contact_probability),
    FIELDS(estimate, "real", force_aligned, cop_aligned, cop_foot_aligned),
    FIELDS(estimate, "whole", flags),
    FIELDS(estimate, "byte", cop_valid, cop_foot_valid),
    FIELDS(filter, "word", config, own),
    FIELDS(filter, "whole", method),
    FIELDS(tare_config, "int", settle, minimum_samples),
    FIELDS(tare_config, "real", spread, limit),
    PARTS(tare_state, front_, front., "real", raw, history, motion, silent, constant, late),
    PARTS(tare_state, front_, front., "whole", known, clean),
    FIELDS(tare_state, "whole", airborne, count),
    FIELDS(tare_state, "real", mean, scatter, offset),
    FIELDS(front, "real", raw, history, motion, silent, constant, late),
    FIELDS(front, "whole", known, clean),
    FIELDS(moment_config, "int", components, capacity, held, steady, talks, carries, talk_to, talk_from),
    FIELDS(moment_config, "real", first_variance, walk, block, ahead, kept_time, longest_pause,
        product_time, largest_error, level, least_read, held_chance, velocity_variance, spin_variance, ripple,
        least_load),
    FIELDS(moment_config, "real", tare_variance, tare_share, least_apart, rate_share, smallest_rate, largest_rate,
        tare_surprise, stated_rate, first_rate, tare_leap, largest_load, largest_tared, loaded, rough_density,
        spread_scale),
    FIELDS(moment_config, "real", least_cosine, spread_offset, noise_spread, zero_jump, unconfirmed, roughest),
    FIELDS(moment_config, "real", level_time, least_still, below, com_below, tilt_memory, tilt_noise, tilt_mean, tilt_std),
    FIELDS(moment_config, "real", unit, severities, likely, wide, least_narrower, most_load, least_row,
        reading_noise),
    FIELDS(moment_config, "real", mode_time, mode_force, mode_torque, rates, first_chance,
        least_chance, least_published),
    FIELDS(moment_config, "real", leg_time, spin_time, first_speed, fastest, sure, contrast, alike, smallest_step,
        least_error, suspect_share, suspect_noise, suspect_surprise),
    FIELDS(moment_config, "real", versus_slack, versus_factor, versus_explained, versus_memory, versus_independent, versus_sure),
    PARTS(moment_state, front_, front., "real", raw, history, motion, silent, constant, late),
    PARTS(moment_state, front_, front., "whole", known, clean),
    PARTS(moment_state, track_, track., "real", motion, heading, origin, velocity, spin, adrift),
    PARTS(moment_state, track_, track., "whole", samples),
    PARTS(moment_state, faults_, faults., "real", last, leapt, moments, lost, wiring, spare, spare_std,
        agreed, level, shown, expected, alive, missed, offered),
    PARTS(moment_state, faults_, faults., "whole", leaps, kind, altered),
    FIELDS(moment_state, "real", pending, before, point, time, drifted, shift, covariance),
    FIELDS(moment_state, "whole", waiting, linked, status),
    PARTS(moment_state, tare_, tare., "real", reading, moved, time, sure, offered, offer, rough, rate),
    PARTS(moment_state, tare_, tare., "whole", followed),
    PARTS(moment_state, still_, still., "real", reading, level, time),
    PARTS(moment_state, suspects_, suspects., "real", score, before, error, noise, known, force),
    PARTS(moment_state, versus_start_, versus_start., "real", time, learnt_mean, learnt_square, start_mean,
        start_square, precision, evidence),
    PARTS(moment_state, tilt_, tilt., "real", shift, time),
    PARTS(moment_state, belief_, belief., "real", mean, covariance, chance, com_shift),
    PARTS(moment_state, published_, published., "real", mean, covariance, undetermined),
    PARTS(moment_state, kept_belief_, kept.belief., "real", mean, covariance, chance, com_shift),
    PARTS(moment_state, kept_published_, kept.published., "real", mean, covariance, undetermined),
    PARTS(moment_state, kept_tare_, kept.tare., "real", reading, moved, time, sure, offered, offer, rough, rate),
    PARTS(moment_state, kept_tare_, kept.tare., "whole", followed),
    PARTS(moment_state, kept_next_belief_, next.belief., "real", mean, covariance, chance, com_shift),
    PARTS(moment_state, kept_next_published_, next.published., "real", mean, covariance, undetermined),
    PARTS(moment_state, kept_next_tare_, next.tare., "real", reading, moved, time, sure, offered, offer, rough, rate),
    PARTS(moment_state, kept_next_tare_, next.tare., "whole", followed),
    PARTS(moment_state, kept_, , "real", age),
    {"moment_work", "numbers", "", 0, sizeof(sf_moment_work)}, /* of which nobody reads one */
    FIELDS(model, "int", bodies, hinges, parent, hinge_body, turned, along, away, site_body),
    FIELDS(model, "real", place, R_parent_body, anchor, axis, zero, mass, com, inertia, position_site, R_body_site),
    FIELDS(timing, "int", averaged, joined, filled, needed, window, feet, points, rolls),
    FIELDS(timing, "real", legs_speed, outlying),
    FIELDS(timing, "real", dt, gravity, legs_noise, velocity_noise, tilt_noise, bias_noise, first_velocity, first_tilt,
           first_bias, turned, known_tilt, vertical_bias_time, ground_time, rest_time, first_time, force_bias_time),
    FIELDS(timing, "real", still_velocity, still_tilt, still_spin, still_speed, still_force, contradiction),
    FIELDS(timing, "real", zero_offset, other_ground, touch, no_normal, sole_height, corners, radius),
    FIELDS(timing, "double", period, delay),
    PARTS(belief, , reference., "real", com, com_acceleration, angular_momentum_rate, position_sole, R_level_sole),
    PARTS(belief, , reference., "byte", stance, swing, momentum),
    FIELDS(belief, "real", accelerometer, gyroscope, ground),
    FIELDS(belief, "byte", known, fell),
    PART(momentum_belief, com_velocity, reference.com_acceleration, "real"),
    PART(momentum_belief, angular_momentum, reference.angular_momentum_rate, "real"),
    PARTS(momentum_belief, , reference., "real", com, position_sole, R_level_sole),
    PARTS(momentum_belief, , reference., "byte", stance, swing, momentum),
    FIELDS(momentum_belief, "real", accelerometer, gyroscope, ground),
    FIELDS(momentum_belief, "byte", known, fell),
    FIELDS(view, "real", force_bound, cop_bound, weight),
    FIELDS(view, "int", flawed, rolls),
    FIELDS(shown, "single", foot_force, foot_load, cop_foot, cop, wrench, vgrf, foot_force_std, cop_std, cop_valid,
        contact_probability, undetermined),
    FIELDS(shown, "single", foot_force_aligned, cop_foot_aligned, cop_aligned),
    FIELDS(shown, "int", foot_flags),
    FIELDS(told, "", belief, estimate, shown),
    FIELDS(told, "real", covariance),
    FIELDS(sample_records, "word", model, timing, beliefs, belief, planned, filter, state, raw, estimate, view, held,
        told, counts),
    FIELDS(sample_records, "double", dt),
    FIELDS(sample_records, "whole", momentum),
};
/* clang-format on */

LIBRARY_OF(places)

EXPORTED int surefoot_fits(const sf_filter *f) {
    return f->method == MOMENT ? sf_moment_fits(f->config, (const sf_moment_config *)f->own)
                               : sf_robot_fits(f->config);
}
#ifndef SF_NO_LIBC /* kernels call the headers themselves */
/* Of which nothing is remembered; too large for the stacks of some threads. */
static __thread sf_moment_work moment_work;

EXPORTED void surefoot_init(const sf_filter *f, void *state) {
    if (f->method == MOMENT) sf_moment_init(f->config, f->own, state, &moment_work);
    if (f->method == TARE) sf_tare_init(f->config, state);
    if (f->method == UNCORRECTED) sf_front_init(f->config, state);
}
EXPORTED void surefoot_retract(const sf_filter *f, void *state) {
    if (f->method == MOMENT) sf_moment_retract(f->config, f->own, state);
}
EXPORTED void surefoot_step(const sf_filter *f, void *state, const sf_real *raw, const sf_belief *belief,
                            double dt, sf_estimate *out) {
    const sf_reference *reference = &belief->reference;
    switch (f->method) {
    case MOMENT:
        sf_moment_step(f->config, f->own, state, &moment_work, raw, reference, (sf_real)dt, out);
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
