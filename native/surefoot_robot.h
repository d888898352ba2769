/* What every calibrator of one robot's feet needs in C99: checks of readings and references, lag and age, faults of
   single channels, forces and centres of pressure, and the algebra behind filters.

   The specification is the Python in calibration/front_end, calibration/moment/faults.py and stand_in.py. A function here
   has the name of the Python function that it is equal to. Nothing is allocated, nothing is global, and nothing is read
   or written but what is passed in. Matrices are stored by rows without gaps, as wide as the robot at hand needs: arrays
   hold the largest one.

   Before it is included: SF_SINGLE makes numbers floats; SF_CHANNELS, SF_FEET and SF_LAG are the largest sizes; SF_API
   is what stands before functions. */

#ifndef SUREFOOT_ROBOT_H
#define SUREFOOT_ROBOT_H

#ifndef SF_NO_LIBC /* see device.h */
#include <math.h>
#include <string.h>
#endif

/* -------------------------------------------------------------------------------------- sizes and numbers */

#ifdef SF_SINGLE
typedef float sf_real;
#define sf_sqrt sqrtf
#define sf_fabs fabsf
#define sf_exp expf
#define sf_log logf
#define SF_EPSILON 1.1920929e-07f
#else
typedef double sf_real;
#define sf_sqrt sqrt
#define sf_fabs fabs
#define sf_exp exp
#define sf_log log
#define SF_EPSILON 2.220446049250313e-16
#endif
typedef long long sf_whole;

/* Numbers that are added and multiplied at once, wherever they lie: as many as a register holds. */
#if !defined(__GNUC__) || defined(__CUDACC__)
#define SF_WIDE 1
typedef sf_real sf_wide;
#else
#ifdef __AVX__
#define SF_WIDE 4
#elif defined(SF_SINGLE)
#define SF_WIDE 4
#else
#define SF_WIDE 2
#endif
typedef sf_real sf_wide __attribute__((vector_size(SF_WIDE * sizeof(sf_real)), aligned(sizeof(sf_real)), may_alias));
#endif

#ifndef SF_API
#define SF_API static inline
#endif
#ifndef SF_CHANNELS
#define SF_CHANNELS 24 /* six axes in four feet, three in eight */
#endif
#ifndef SF_FEET
#define SF_FEET 8
#endif
#ifndef SF_LAG
#define SF_LAG 8
#endif

#define SF_MOTION (15 + 12 * SF_FEET)

/* Bits of `flags`; see surefoot.calibration.estimate.Flag. */
enum {
    SF_MISSING = 1,
    SF_OUT_OF_RANGE = 2,
    SF_REFERENCE = 4,
    SF_GAP = 8,
    SF_NO_CONTACT = 16,
    SF_SINGULAR = 32,
    SF_STANDING = 64,
    SF_REJECTED = 128,
    SF_SPIKE = 256,
    SF_STUCK = 512,
    SF_DEAD = 1024,
    SF_FLIPPED = 2048,
    SF_SWAPPED = 4096,
    SF_LOST = 8192,
    SF_SATURATED = 16384,
    SF_HELD = 32768,
    SF_WORSE_THAN_START = 65536
};

/* Places in a flat reference; behind them the soles' positions (3 each) and rotations (9 each). */
enum { SF_COM = 0, SF_ACCELERATION = 3, SF_RATE = 6, SF_ACCELEROMETER = 9, SF_GYROSCOPE = 12, SF_SOLES = 15 };

/* Rows of a wrench. */
enum { SF_FX, SF_FY, SF_FZ, SF_MX, SF_MY, SF_MZ };

/* Constants of the Python modules, by their names there. */
#define SF_LONGEST_GAP 5.0
#define SF_MOST_SILENCE ((sf_real)3600)
#define SF_SLOPE_SAMPLES 3
#define SF_LARGEST_REFERENCE ((sf_real)1e6)
#define SF_FARTHEST ((sf_real)5)
#define SF_LARGEST_WEIGHTS ((sf_real)5.0)
#define SF_FLOOR ((sf_real)1e-5)
#define SF_LONGEST_LEAP 3
#define SF_LEAST_LEAP_SCALE ((sf_real)0.3)
#define SF_LARGEST_LEAP_SCALE ((sf_real)3.0)
#define SF_ALONE ((sf_real)4.0)
#define SF_BACK ((sf_real)0.25)
#define SF_SPIKE_LOAD ((sf_real)0.02)
#define SF_BUMPY ((sf_real)1.5)
#define SF_BUMP_MEMORY ((sf_real)0.993)
#define SF_ONCE ((sf_real)0.5)
#define SF_MOVING ((sf_real)0.02)
#define SF_MOSTLY_MISSING ((sf_real)0.5)
#define SF_ALL_READ ((sf_real)0.99)
#define SF_IDLE ((sf_real)0.1)
#define SF_PLATE_MOVED ((sf_real)0.2)
#define SF_LARGEST_CHANGE ((sf_real)0.15)
#define SF_MISSED ((sf_real)0.5)
#define SF_NO_LOAD ((sf_real)0.1)
#define SF_HEAVIEST ((sf_real)2.0)
#define SF_RETURN_BLOCKS ((sf_real)15.0)
#define SF_AGREE ((sf_real)0.03)
#define SF_AGREE_SHARE ((sf_real)0.2)

/* ------------------------------------------------------------------------------------------------ records */

/* Constants of one robot: an OnlineSetup, and how its cells stand in for each other. K channels; units as in Python. */
typedef struct {
    int channels, feet, lag, kept, aligned_lag;
    int foot_of_channel[SF_CHANNELS];
    int cells[SF_CHANNELS]; /* 1 for a cell under a plate: others cannot be reconstructed */
    int together[SF_CHANNELS * SF_CHANNELS]; /* 1 for two cells of one plate */
    sf_real dt, weight, mass, gravity, length, reach, force_threshold, longest_silence;
    sf_real carried[SF_CHANNELS]; /* by how long each is extrapolated to now in s; 0 for readings without an age */
    sf_real age[SF_CHANNELS];     /* mean age of readings in s */
    sf_real scale[SF_CHANNELS], offset[SF_CHANNELS], lowest[SF_CHANNELS], highest[SF_CHANNELS];
    sf_real wrench_map[SF_FEET * 6 * SF_CHANNELS];
    sf_real leap, leap_alone[SF_CHANNELS], renewal;
    sf_real prior[SF_CHANNELS * SF_CHANNELS], by_others[SF_CHANNELS * SF_CHANNELS];
} sf_config;

/* What the robot believes of itself `lag` samples ago; see surefoot.calibration.reference.Reference. Of one that holds
   momentum, a MomentumReference, velocity and angular momentum stand in the place of their rates. */
typedef struct {
    sf_real com[3], com_acceleration[3], angular_momentum_rate[3];
    sf_real position_sole[SF_FEET * 3], R_level_sole[SF_FEET * 9];
    unsigned char stance[SF_FEET], swing[SF_FEET];
    unsigned char momentum; /* whether it holds momentum */
} sf_reference;

/* What the way of a sample remembers, with any method: FrontState. */
typedef struct {
    sf_real raw[SF_CHANNELS], history[(SF_LAG + 1) * 3 * SF_CHANNELS], motion[SF_MOTION];
    sf_real silent[SF_CHANNELS]; /* time in s since each channel was last read */
    sf_real constant; /* time in s since any reading last changed, and more if it changed by little */
    sf_real late[SF_CHANNELS]; /* by how much the coming readings are older than their mean age in s; 0 if not known */
    sf_whole known, clean;
} sf_front;

/* One sample, checked: the newest forces by the starting map, and what is wrong with them. */
typedef struct {
    sf_real dt, force[SF_CHANNELS];
    sf_whole flags[SF_CHANNELS];
    sf_real change[SF_CHANNELS]; /* by how much they are expected to have changed until now */
    sf_real past[2 * SF_CHANNELS]; /* what the reference describes: forces, and whether each was read (0 or 1) */
    sf_real aligned[SF_CHANNELS]; /* forces of all channels at one moment, `aligned_lag` samples ago */
    int read[SF_CHANNELS], sound, gap, good; /* a good reference; a clock that jumped; all to be learnt from */
    int repeated; /* whether all readings are those of the sample before */
} sf_sample;

/* What is known of the channels' faults, but for what hypotheses say: ChannelState. */
typedef struct {
    sf_real last[SF_CHANNELS];
    sf_whole leaps[SF_CHANNELS];
    sf_real leapt[SF_CHANNELS], moments[SF_CHANNELS * SF_CHANNELS], lost[SF_CHANNELS];
    sf_whole kind[SF_CHANNELS];
    sf_real wiring[SF_CHANNELS * SF_CHANNELS], spare[SF_CHANNELS * SF_CHANNELS];
    sf_real spare_std[SF_CHANNELS], agreed[SF_CHANNELS];
    sf_real level[SF_CHANNELS], shown[SF_CHANNELS], expected[SF_CHANNELS];
    sf_real missed[SF_CHANNELS], offered[SF_CHANNELS], alive[SF_CHANNELS];
    sf_whole altered;
} sf_channel_faults;

/* A calibrated sample; see surefoot.calibration.estimate.Estimate. The covariance is in the state. */
typedef struct {
    sf_real force[SF_CHANNELS], wrench[SF_FEET * 6], vgrf[SF_FEET], cop[2], cop_measured[2], cop_foot[SF_FEET * 2];
    sf_real scale[SF_CHANNELS], offset[SF_CHANNELS], force_std[SF_CHANNELS], cop_covariance[4], nis, nis_rows;
    sf_real undetermined[SF_CHANNELS], contact_probability[SF_FEET]; /* NaN of methods that do not weigh them */
    sf_real force_aligned[SF_CHANNELS], cop_aligned[2], cop_foot_aligned[SF_FEET * 2];
    sf_whole flags[SF_CHANNELS];
    unsigned char cop_valid, cop_foot_valid[SF_FEET];
} sf_estimate;

SF_API int sf_motion(const sf_config *c) { return 15 + 12 * c->feet; }

/* Return whether a robot fits into the arrays, with any method. */
SF_API int sf_robot_fits(const sf_config *c) {
    int fits = c->channels >= 1 && c->channels <= SF_CHANNELS && c->feet >= 1 && c->feet <= SF_FEET &&
               c->lag >= 0 && c->lag <= c->kept && c->aligned_lag >= 0 && c->aligned_lag <= c->kept && c->kept <= SF_LAG;
    for (int i = 0; fits && i < c->channels; i++)
        fits = c->foot_of_channel[i] >= 0 && c->foot_of_channel[i] < c->feet &&
               (c->carried[i] == 0 || c->kept >= SF_SLOPE_SAMPLES);
    return fits;
}

/* ----------------------------------------------------------------------------------------- linear algebra */

SF_API sf_real sf_min(sf_real a, sf_real b) { return b < a ? b : a; }
SF_API sf_real sf_power2(sf_real a) { return a * a; }
SF_API sf_real sf_max(sf_real a, sf_real b) { return b > a ? b : a; }
SF_API sf_real sf_clip(sf_real value, sf_real low, sf_real high) { return sf_min(sf_max(value, low), high); }
SF_API int sf_finite(sf_real value) { return value - value == 0; }

SF_API sf_wide *sf_at(sf_real *numbers) { return (sf_wide *)numbers; }
SF_API const sf_wide *sf_from(const sf_real *numbers) { return (const sf_wide *)numbers; }

SF_API void sf_copy(sf_real *to, const sf_real *from, int n) {
    memcpy(to, from, (size_t)n * sizeof(sf_real));
}

SF_API int sf_all_finite(const sf_real *values, int n) {
    /* What is not finite leaves NaN; in four parts, as of sf_dot. */
    sf_real off[4] = {0, 0, 0, 0};
    int i = 0;
    for (; i + 4 <= n; i += 4)
        for (int l = 0; l < 4; l++) off[l] += values[i + l] - values[i + l];
    for (; i < n; i++) off[0] += values[i] - values[i];
    return off[0] == 0 && off[1] == 0 && off[2] == 0 && off[3] == 0;
}

/* Sums in four parts: one after the other would wait for every addition. */
SF_API sf_real sf_dot(const sf_real *a, const sf_real *b, int n) {
    sf_real s0 = 0, s1 = 0, s2 = 0, s3 = 0;
    int i = 0;
    for (; i + 4 <= n; i += 4) {
        s0 += a[i] * b[i];
        s1 += a[i + 1] * b[i + 1];
        s2 += a[i + 2] * b[i + 2];
        s3 += a[i + 3] * b[i + 3];
    }
    for (; i < n; i++) s0 += a[i] * b[i];
    return (s0 + s1) + (s2 + s3);
}

/* to += factor * from */
SF_API void sf_add(sf_real *__restrict to, sf_real factor, const sf_real *__restrict from, int n) {
    for (int i = 0; i < n; i++) to[i] += factor * from[i];
}

/* to += sign * sum of factor[k * apart] * B[k * wide ...] over `inner` rows, of n numbers each: a few at a time, which
   stay in registers over all rows. */
SF_API void sf_add_rows(sf_real *__restrict to, sf_real sign, const sf_real *factor, int apart,
                        const sf_real *B, int wide, int inner, int n) {
    const int one = SF_WIDE, two = 2 * SF_WIDE, three = 3 * SF_WIDE, four = 4 * SF_WIDE;
    for (; n >= four; n -= four, to += four, B += four) {
        sf_wide a = *sf_at(to), b = *sf_at(to + one), c = *sf_at(to + two), d = *sf_at(to + three);
        for (int k = 0; k < inner; k++) {
            const sf_real by = sign * factor[k * apart], *row = B + k * wide;
            a += by * *sf_from(row), b += by * *sf_from(row + one);
            c += by * *sf_from(row + two), d += by * *sf_from(row + three);
        }
        *sf_at(to) = a, *sf_at(to + one) = b, *sf_at(to + two) = c, *sf_at(to + three) = d;
    }
    for (; n >= one; n -= one, to += one, B += one) {
        sf_wide a = *sf_at(to);
        for (int k = 0; k < inner; k++) a += sign * factor[k * apart] * *sf_from(B + k * wide);
        *sf_at(to) = a;
    }
    for (; n > 0; n--, to++, B++) {
        sf_real a = *to;
        for (int k = 0; k < inner; k++) a += sign * factor[k * apart] * B[k * wide];
        *to = a;
    }
}

/* out = A B, shapes (rows, inner) and (inner, columns). */
SF_API void sf_multiply(sf_real *out, const sf_real *A, const sf_real *B, int rows, int inner, int columns) {
    memset(out, 0, (size_t)(rows * columns) * sizeof(sf_real));
    for (int i = 0; i < rows; i++)
        sf_add_rows(out + i * columns, 1, A + i * inner, 1, B, columns, inner, columns);
}

/* Overwrite the upper half of a positive definite A with U, A = U' U; returns 0 if it is none. What is below is lost. Rows
   have `wide` numbers: what stands behind A becomes U'^-1 of that. */
SF_API int sf_cholesky(sf_real *A, int n, int wide) {
    for (int i = 0; i < n; i++) {
        sf_real *row = A + i * wide;
        int from = i / 8 * 8; /* so that rows are of whole registers */
        sf_add_rows(row + from, -1, A + i, wide, A + from, wide, i, wide - from);
        if (!(row[i] > 0) || !sf_finite(row[i])) return 0;
        sf_real by = 1 / sf_sqrt(row[i]);
        for (int j = from; j < wide; j++) row[j] *= by;
    }
    return 1;
}

/* Overwrite B, shape (n, columns), with U^-1 B, for U of rows of `wide` numbers. */
SF_API void sf_solve_back(const sf_real *U, int n, int wide, sf_real *B, int columns) {
    for (int i = n - 1; i >= 0; i--) {
        sf_real *row = B + i * columns, by = 1 / U[i * wide + i];
        sf_add_rows(row, -1, U + i * wide + i + 1, 1, row + columns, columns, n - i - 1, columns);
        for (int j = 0; j < columns; j++) row[j] *= by;
    }
}

/* Overwrite B, shape (n, columns), with (U' U)^-1 B. */
SF_API void sf_solve(const sf_real *U, int n, int wide, sf_real *B, int columns) {
    for (int i = 0; i < n; i++) {
        sf_real *row = B + i * columns, by = 1 / U[i * wide + i];
        sf_add_rows(row, -1, U + i, wide, B, columns, i, columns);
        for (int j = 0; j < columns; j++) row[j] *= by;
    }
    sf_solve_back(U, n, wide, B, columns);
}

SF_API void sf_cross(sf_real *out, const sf_real *a, const sf_real *b) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

/* out = R v, and out = R' v */
SF_API void sf_turn(sf_real *out, const sf_real *R, const sf_real *v) {
    for (int i = 0; i < 3; i++) out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2];
}

SF_API void sf_turn_back(sf_real *out, const sf_real *R, const sf_real *v) {
    for (int i = 0; i < 3; i++) out[i] = R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2];
}

/* ---------------------------------------------------------------------------- front_end: motion, readings */

SF_API const sf_real *sf_position(const sf_real *motion, int foot) { return motion + SF_SOLES + 3 * foot; }

SF_API const sf_real *sf_rotation(const sf_config *c, const sf_real *motion, int foot) {
    return motion + SF_SOLES + 3 * c->feet + 9 * foot;
}

/* Motions.flatten, without the IMU, whose entries are zero. */
SF_API void sf_flatten(const sf_config *c, const sf_reference *reference, sf_real *motion) {
    memset(motion, 0, SF_SOLES * sizeof(sf_real));
    sf_copy(motion + SF_COM, reference->com, 3);
    sf_copy(motion + SF_ACCELERATION, reference->com_acceleration, 3);
    sf_copy(motion + SF_RATE, reference->angular_momentum_rate, 3);
    sf_copy(motion + SF_SOLES, reference->position_sole, 3 * c->feet);
    sf_copy(motion + SF_SOLES + 3 * c->feet, reference->R_level_sole, 9 * c->feet);
}

SF_API sf_real sf_ground_height(const sf_config *c, const sf_real *motion) {
    sf_real height = sf_position(motion, 0)[2];
    for (int foot = 1; foot < c->feet; foot++) height = sf_min(height, sf_position(motion, foot)[2]);
    return height;
}

/* Motions.ground: the vertical force and the centre of pressure that a motion asks for (Eqs. 9-11, or Han's);
   returns whether a robot can do that at all. */
SF_API int sf_ground(const sf_config *c, const sf_real *motion, int quasi_static, sf_real asked[3]) {
    const sf_real *com = motion + SF_COM, *acceleration = motion + SF_ACCELERATION, *rate = motion + SF_RATE;
    sf_real vgrf = quasi_static ? c->weight : c->mass * (acceleration[2] + c->gravity),
            safe = vgrf > c->force_threshold ? vgrf : c->weight;
    sf_real height = c->mass * (com[2] - sf_ground_height(c, motion));
    int near = 1;
    asked[0] = vgrf;
    asked[1] = com[0] - (quasi_static ? 0 : (height * acceleration[0] + rate[1]) / safe);
    asked[2] = com[1] - (quasi_static ? 0 : (height * acceleration[1] - rate[0]) / safe);
    for (int foot = 0; foot < c->feet; foot++)
        for (int axis = 0; axis < 2; axis++)
            near = near && sf_fabs(sf_position(motion, foot)[axis] - asked[1 + axis]) <= c->reach;
    return near && vgrf > c->force_threshold && vgrf < SF_LARGEST_WEIGHTS * c->weight;
}

/* Motions.rows: what a newton on each channel adds to (Fz, Fz px, Fz py), shape (3, K); the other foot's are zero. */
SF_API void sf_level_rows(const sf_config *c, const sf_real *motion, sf_real *rows) {
    int K = c->channels;
    for (int i = 0; i < K; i++) {
        int foot = c->foot_of_channel[i];
        const sf_real *R = sf_rotation(c, motion, foot), *at = sf_position(motion, foot);
        const sf_real *map = c->wrench_map + foot * 6 * K + i;
        sf_real force[3] = {map[0], map[K], map[2 * K]}, torque[3] = {map[3 * K], map[4 * K], map[5 * K]};
        sf_real up = sf_dot(R + 6, force, 3);
        rows[i] = up;
        rows[K + i] = at[0] * up - sf_dot(R + 3, torque, 3);
        rows[2 * K + i] = at[1] * up + sf_dot(R, torque, 3);
    }
}

/* FrontEnd.init */
SF_API void sf_front_init(const sf_config *c, sf_front *s) {
    memset(s, 0, sizeof *s);
    for (int foot = 0; foot < c->feet; foot++)
        for (int i = 0; i < 3; i++) s->motion[SF_SOLES + 3 * c->feet + 9 * foot + 4 * i] = 1;
    for (int i = 0; i < c->channels; i++) s->raw[i] = 0 - c->offset[i] / c->scale[i];
}

/* FrontEnd.observe until forces may be repaired: check one sample. */
SF_API void sf_check(const sf_config *c, sf_front *s, const sf_real *raw, const sf_reference *reference,
                     sf_real dt, sf_sample *sample) {
    int R = sf_motion(c);
    sf_real motion[SF_MOTION];
    sf_flatten(c, reference, motion);
    sample->dt = dt;
    sample->gap = !(dt > 0 && dt <= SF_LONGEST_GAP * c->dt);
    sample->sound = 1;
    for (int i = 0; i < R; i++) sample->sound = sample->sound && sf_fabs(motion[i]) <= SF_LARGEST_REFERENCE;
    for (int i = 0; i < 3 * c->feet; i++)
        sample->sound = sample->sound && sf_fabs(motion[SF_SOLES + i] - motion[SF_COM + i % 3]) <= SF_FARTHEST;
    sf_real passed = dt > 0 && dt < SF_MOST_SILENCE ? dt : c->dt;
    sf_real change = 0;
    for (int i = 0; i < c->channels; i++) {
        sample->read[i] = raw[i] >= c->lowest[i] && raw[i] <= c->highest[i];
        if (sample->read[i]) change = sf_max(change, sf_fabs(c->scale[i] * (raw[i] - s->raw[i])));
        sample->flags[i] = (sample->read[i] ? 0 : raw[i] == raw[i] ? SF_OUT_OF_RANGE : SF_MISSING) |
                           (sample->sound ? 0 : SF_REFERENCE) | (sample->gap ? SF_GAP : 0);
        if (sample->read[i]) s->raw[i] = raw[i], s->silent[i] = 0;
        else s->silent[i] = sf_min(s->silent[i] + passed, SF_MOST_SILENCE);
        sample->force[i] = c->scale[i] * s->raw[i] + c->offset[i];
    }
    s->constant = change == 0 ? s->constant + passed : change > SF_MOVING * c->weight ? 0 : c->longest_silence;
    s->constant = sf_min(s->constant, SF_MOST_SILENCE);
    sample->repeated = change == 0 && s->constant < c->longest_silence;
    if (sample->sound) sf_copy(s->motion, motion, R);
    s->known = s->known || sample->sound;
}

/* ages.force_at: K forces some samples ago, interpolated between the readings around then. */
SF_API void sf_force_at(const sf_config *c, const sf_front *s, int back, const sf_real *delay, sf_real *force) {
    int K = c->channels;
    for (int i = 0; i < K; i++) {
        const sf_real *row = s->history + c->kept * 3 * K + i;
        sf_real moment = -(sf_real)back * c->dt + (delay ? delay[i] : 0), later = 0, force_later = 0;
        int found = 0, after = 0;
        force[i] = row[-back * 3 * K];
        for (int t = 0; t <= c->kept && !found; t++, row -= 3 * K) {
            sf_real time = -(sf_real)t * c->dt - row[2 * K];
            if (!(row[K] > (sf_real)0.5)) continue;
            found = time <= moment;
            if (found) force[i] = row[0] + (after ? (moment - time) / (later - time) : 0) * (force_later - row[0]);
            else after = 1, later = time, force_later = row[0];
        }
        if (!found && after) force[i] = force_later;
    }
}

/* expected_change: by how much forces have changed since they were read, in N. */
SF_API void sf_expected_change(const sf_config *c, const sf_front *s, sf_real dt, sf_real *change) {
    int K = c->channels, back = c->kept - SF_SLOPE_SAMPLES;
    for (int i = 0; i < K; i++) {
        change[i] = 0;
        if (back >= 0 && c->carried[i] > 0 && s->clean >= SF_SLOPE_SAMPLES) {
            const sf_real *newest = s->history + c->kept * 3 * K + i, *before = s->history + back * 3 * K + i;
            sf_real interval = sf_max(dt, c->dt);
            sf_real passed = sf_max(SF_SLOPE_SAMPLES * interval - newest[2 * K] + before[2 * K], interval);
            if (newest[K] > (sf_real)0.5 && before[K] > (sf_real)0.5)
                change[i] = (c->carried[i] + newest[2 * K]) * ((newest[0] - before[0]) / passed);
        }
    }
}

/* FrontEnd.observe from there on: remember the sample and see whether that which the reference describes may be
   learnt from. */
SF_API void sf_align(const sf_config *c, sf_front *s, sf_sample *sample) {
    int K = c->channels;
    sf_real *newest = s->history + c->kept * 3 * K;
    const sf_real *read = newest - (c->lag * 3 - 1) * K;
    memmove(s->history, s->history + 3 * K, (size_t)(c->kept * 3 * K) * sizeof(sf_real));
    sf_copy(newest, sample->force, K);
    for (int i = 0; i < K; i++) {
        newest[K + i] = (sf_real)(sample->read[i] && !sample->repeated);
        newest[2 * K + i] = s->late[i];
        s->late[i] = 0;
    }
    sf_force_at(c, s, c->lag, 0, sample->past);
    sf_force_at(c, s, c->aligned_lag, c->age, sample->aligned);
    sample->good = sample->sound && !sample->gap;
    for (int i = 0; i < K; i++) {
        sample->past[K + i] = (sf_real)(read[i] > (sf_real)0.5);
        sample->good = sample->good && read[i] > (sf_real)0.5;
    }
    s->clean = sample->good ? s->clean + 1 : 0;
    sf_expected_change(c, s, sample->dt, sample->change);
}

/* FrontEnd.report: what calibrated forces mean. rows: of sf_level_rows; returns the load on all feet in N. */
SF_API sf_real sf_report(const sf_config *c, const sf_front *s, const sf_real *rows, sf_estimate *out) {
    int K = c->channels, stale = 0;
    sf_real load = 0;
    for (int foot = 0; foot < c->feet; foot++) {
        sf_real *wrench = out->wrench + 6 * foot, *cop = out->cop_foot + 2 * foot;
        int of_now = 1;
        for (int axis = 0; axis < 6; axis++)
            wrench[axis] = sf_dot(c->wrench_map + (foot * 6 + axis) * K, out->force, K);
        out->vgrf[foot] = 0;
        for (int i = 0; i < K; i++)
            if (c->foot_of_channel[i] == foot) {
                out->vgrf[foot] += rows[i] * out->force[i];
                of_now = of_now && s->silent[i] <= c->longest_silence;
            }
        load += out->vgrf[foot];
        stale = stale || !of_now;
        out->cop_foot_valid[foot] = of_now && wrench[SF_FZ] > c->force_threshold;
        cop[0] = out->cop_foot_valid[foot] ? -wrench[SF_MY] / wrench[SF_FZ] + 0 : (sf_real)NAN;
        cop[1] = out->cop_foot_valid[foot] ? wrench[SF_MX] / wrench[SF_FZ] + 0 : (sf_real)NAN;
    }
    for (int i = 0; i < K; i++) out->undetermined[i] = (sf_real)NAN;
    for (int foot = 0; foot < c->feet; foot++) out->contact_probability[foot] = (sf_real)NAN;
    out->cop_valid = !stale && load > c->force_threshold && s->known;
    for (int axis = 0; axis < 2; axis++)
        out->cop[axis] = out->cop_valid ? sf_dot(rows + (1 + axis) * K, out->force, K) / load + 0 : (sf_real)NAN;
    sf_copy(out->cop_measured, out->cop, 2);
    return load;
}

/* The same, with the common centre of pressure extrapolated to now, and all of them at the moment of aligned forces,
   which are in `out`. change: of each force until now in N (with_total_kept). */
SF_API sf_real sf_report_now(const sf_config *c, const sf_front *s, const sf_real *rows, const sf_real *change,
                             sf_estimate *out) {
    int K = c->channels;
    sf_real load, room = 0, excess = 0, now[SF_CHANNELS];
    sf_estimate other = *out;
    sf_copy(other.force, out->force_aligned, K);
    sf_report(c, s, rows, &other);
    sf_copy(out->cop_aligned, other.cop, 2);
    sf_copy(out->cop_foot_aligned, other.cop_foot, 2 * c->feet);
    for (int i = 0; i < K; i++) {
        room += rows[i] * change[i] * change[i] * rows[i];
        excess += rows[i] * change[i];
    }
    load = sf_report(c, s, rows, out);
    if (!(room > 0) || !out->cop_valid) return load;
    for (int i = 0; i < K; i++) now[i] = out->force[i] + change[i] - rows[i] * change[i] * change[i] * (excess / room);
    for (int axis = 0; axis < 2; axis++) out->cop[axis] = sf_dot(rows + (1 + axis) * K, now, K) / sf_dot(rows, now, K) + 0;
    return load;
}

/* ------------------------------------------------------------------------------------------------- faults */

/* StandIn.others: how each channel follows from those that are not lost, and how well in N. */
SF_API void sf_others(const sf_config *c, const sf_channel_faults *s, sf_real *others, sf_real *spread) {
    int K = c->channels;
    sf_real L[SF_CHANNELS * SF_CHANNELS], precision[SF_CHANNELS * SF_CHANNELS], row[SF_CHANNELS], cut[SF_CHANNELS];
    for (int i = 0; i < K; i++)
        for (int j = 0; j < K; j++) {
            sf_real moment = s->moments[i * K + j] + (i == j) * SF_FLOOR;
            /* Lost channels are cut off from the others, so that the inverse is that of those that are there. */
            L[i * K + j] = moment * (1 - s->lost[i]) * (1 - s->lost[j]) + (i == j) * s->lost[i];
            precision[i * K + j] = i == j;
        }
    if (!sf_cholesky(L, K, K)) { /* never while the floor holds; nothing then follows from nothing */
        memset(others, 0, (size_t)(K * K) * sizeof(sf_real));
        for (int i = 0; i < K; i++) spread[i] = c->weight;
        return;
    }
    sf_solve(L, K, K, precision, K);
    for (int i = 0; i < K; i++) {
        sf_real own = precision[i * K + i], variance = 1 / own, there = 1 - s->lost[i];
        for (int j = 0; j < K; j++)
            others[i * K + j] = ((sf_real)(i == j) - precision[i * K + j] / own) * there * (1 - s->lost[j]);
        if (s->lost[i] > (sf_real)0.5) {
            for (int j = 0; j < K; j++)
                cut[j] = (s->moments[i * K + j] + (i == j) * SF_FLOOR) * (1 - s->lost[j]);
            sf_multiply(row, cut, precision, 1, K, K);
            variance = s->moments[i * K + i] + SF_FLOOR;
            for (int j = 0; j < K; j++) {
                sf_real of_lost = row[j] * (1 - s->lost[j]) * s->lost[i];
                others[i * K + j] += of_lost;
                variance -= of_lost * (s->moments[i * K + j] + (i == j) * SF_FLOOR);
            }
        }
        spread[i] = sf_sqrt(sf_max(variance, 0)) * c->weight;
    }
}

/* Whether no channel is out. */
SF_API int sf_all_there(const sf_config *c, const sf_channel_faults *s) {
    for (int i = 0; i < c->channels; i++)
        if (s->lost[i] > (sf_real)0.5) return 0;
    return 1;
}

/* StandIn.count_lost for one channel. */
SF_API sf_real sf_lost_of_plate(const sf_config *c, const sf_channel_faults *s, int i) {
    sf_real lost = 0;
    for (int j = 0; j < c->channels; j++) lost += (sf_real)c->together[i * c->channels + j] * s->lost[j];
    return lost;
}

/* ChannelFaults._rebuild: work out how to do without what is lost. */
SF_API void sf_rebuild(const sf_config *c, sf_channel_faults *s) {
    int K = c->channels;
    sf_real others[SF_CHANNELS * SF_CHANNELS], spread[SF_CHANNELS];
    sf_others(c, s, others, spread);
    for (int i = 0; i < K; i++) {
        s->spare_std[i] = spread[i] * s->lost[i];
        for (int j = 0; j < K; j++)
            s->spare[i * K + j] = (i == j) * (1 - s->lost[i]) + others[i * K + j] * s->lost[i];
    }
    s->altered = 1;
}

/* ChannelFaults._return: take channels in again. */
SF_API void sf_return(const sf_config *c, sf_channel_faults *s, const int *back) {
    int any = 0;
    for (int i = 0; i < c->channels; i++) {
        if (!back[i]) continue;
        any = 1;
        s->lost[i] = 0;
        s->kind[i] &= ~(sf_whole)(SF_LOST | SF_DEAD | SF_STUCK | SF_SATURATED | SF_MISSING);
    }
    if (any) sf_rebuild(c, s);
}

/* ChannelFaults._lose: take channels out. */
SF_API void sf_lose(const sf_config *c, sf_channel_faults *s, const int *fresh, const int *kind) {
    int any = 0;
    for (int i = 0; i < c->channels; i++) {
        if (!fresh[i]) continue;
        any = 1;
        s->lost[i] = 1;
        s->kind[i] |= kind[i] | SF_LOST;
    }
    if (any) sf_rebuild(c, s);
}

/* ChannelFaults.init: channels are sound. raw: of the front end at the start. */
SF_API void sf_channel_faults_init(const sf_config *c, sf_channel_faults *s, const sf_real *raw) {
    int K = c->channels;
    memset(s, 0, sizeof *s);
    for (int i = 0; i < K; i++) {
        s->last[i] = c->scale[i] * raw[i] + c->offset[i];
        s->leaps[i] = SF_LONGEST_LEAP + 1;
        s->wiring[i * K + i] = s->spare[i * K + i] = 1;
        s->shown[i] = -1;
    }
    sf_copy(s->moments, c->prior, K * K);
}

/* ChannelFaults.sample: put channels right and hold leaps; forces, whether they were read, and flags, in place.
   scale: what a newton by the starting map is as far as is known; stance: which feet stand by the robot's plan. */
SF_API void sf_fault_sample(const sf_config *c, sf_channel_faults *s, const sf_real *scale,
                            const unsigned char *stance, sf_real *force, int *read, sf_whole *kinds) {
    int K = c->channels, any = 0, leaping[SF_CHANNELS];
    sf_real step[SF_CHANNELS], before[SF_CHANNELS], leapt[SF_CHANNELS], total = 0;
    if (s->altered) {
        int was[SF_CHANNELS];
        sf_copy(before, force, K);
        memcpy(was, read, (size_t)K * sizeof(int));
        for (int i = 0; i < K; i++) {
            sf_real sum = 0;
            force[i] = 0;
            for (int j = 0; j < K; j++) {
                force[i] += s->wiring[i * K + j] * before[j];
                sum += sf_fabs(s->wiring[i * K + j]) * (sf_real)was[j];
            }
            read[i] = sum > (sf_real)0.5;
        }
    }
    for (int i = 0; i < K; i++) {
        step[i] = sf_fabs(force[i] - s->last[i]) *
                  sf_clip(sf_fabs(scale[i]), SF_LEAST_LEAP_SCALE, SF_LARGEST_LEAP_SCALE);
        s->leapt[i] *= SF_BUMP_MEMORY;
        sf_real most = stance[c->foot_of_channel[i]] ? c->leap_alone[i] : c->leap;
        leaping[i] = step[i] > most;
        any = any || leaping[i];
        kinds[i] = s->kind[i];
        if (s->leaps[i] > 0 && s->leaps[i] <= SF_LONGEST_LEAP && read[i] && step[i] < SF_BACK * most) kinds[i] |= SF_SPIKE;
    }
    if (!any) {
        sf_copy(s->last, force, K);
        for (int i = 0; i < K; i++) s->leaps[i] = read[i] ? 0 : SF_LONGEST_LEAP + 1;
        return;
    }
    for (int i = 0; i < K; i++) {
        /* A foot that lands moves several of its cells. */
        sf_real others = 0;
        for (int j = 0; j < K; j++)
            if (j != i && c->foot_of_channel[j] == c->foot_of_channel[i]) others = sf_max(others, step[j]);
        leaping[i] = leaping[i] && read[i] && step[i] > SF_ALONE * others;
        leaping[i] = leaping[i] && s->leaps[i] < SF_LONGEST_LEAP;
        leapt[i] = s->leapt[i] + (sf_real)(leaping[i] && s->leaps[i] == 0);
        total += s->leapt[i];
    }
    for (int i = 0; i < K; i++) {
        leaping[i] = leaping[i] && total - s->leapt[i] < SF_BUMPY;
        s->leapt[i] = leapt[i];
        s->leaps[i] = leaping[i] ? s->leaps[i] + 1 : read[i] ? 0 : SF_LONGEST_LEAP + 1;
        if (leaping[i]) {
            force[i] = s->last[i];
            read[i] = 0;
            kinds[i] |= SF_OUT_OF_RANGE;
        }
        s->last[i] = force[i];
    }
}

/* ChannelFaults.smooth: put readings that were wrong for one sample between their neighbours. Rows begin with K forces
   and K numbers that say whether they were read; weight: the robot's in the unit of forces. */
SF_API void sf_smooth(const sf_config *c, const sf_real *before, sf_real *row, const sf_real *after, sf_real weight) {
    int K = c->channels;
    sf_real away[SF_CHANNELS];
    for (int i = 0; i < K; i++)
        away[i] = sf_fabs(row[i] - sf_clip(row[i], sf_min(before[i], after[i]), sf_max(before[i], after[i])));
    for (int i = 0; i < K; i++) {
        sf_real others = 0;
        int mates = 0;
        for (int j = 0; j < K; j++)
            if (j != i && c->together[i * K + j]) mates++, others = sf_max(others, away[j]);
        if (mates && away[i] > SF_SPIKE_LOAD * weight && away[i] > SF_ALONE * others && row[K + i] > (sf_real)0.5)
            row[i] = (sf_real)0.5 * (before[i] + after[i]);
    }
}

/* ChannelFaults._compare_with_plate: find cells that do not change while all others of their plate say so; return
   whether one was dead from the start. level: mean of a block in body weights. */
SF_API int sf_compare_with_plate(const sf_config *c, sf_channel_faults *s, const sf_real *level, int *idle) {
    int K = c->channels, any = 0, enough[SF_CHANNELS], still[SF_CHANNELS], alone[SF_CHANNELS];
    sf_real step[SF_CHANNELS], change[SF_CHANNELS];
    for (int i = 0; i < K; i++) {
        step[i] = s->shown[i] < 0 ? 0 : level[i] - s->level[i];
        s->level[i] = level[i];
    }
    for (int i = 0; i < K; i++) {
        sf_real others = 0;
        for (int j = 0; j < K; j++)
            if (j != i && c->together[i * K + j]) others = sf_max(others, sf_fabs(step[j]));
        alone[i] = sf_fabs(step[i]) > SF_ALONE * others; /* no plate's load */
    }
    for (int i = 0; i < K; i++) {
        change[i] = step[i];
        for (int j = 0; j < K; j++)
            if (alone[j] && c->together[i * K + j]) change[i] = 0;
    }
    for (int i = 0; i < K; i++) {
        sf_real told = sf_clip(sf_dot(c->by_others + i * K, change, K), -SF_LARGEST_CHANGE, SF_LARGEST_CHANGE);
        sf_real own = sf_clip(change[i], -SF_LARGEST_CHANGE, SF_LARGEST_CHANGE);
        int whole = sf_lost_of_plate(c, s, i) < (sf_real)0.5;
        s->shown[i] = whole ? sf_max(s->shown[i], 0) + own * own : 0;
        s->expected[i] = whole ? s->expected[i] + told * told : 0;
        if (!whole) s->missed[i] = s->offered[i] = 0;
        enough[i] = s->expected[i] > SF_PLATE_MOVED;
        /* On an edge of its plate a sound cell bears nothing as well: then nothing is missed. */
        still[i] = enough[i] && s->shown[i] < SF_IDLE * SF_IDLE * s->expected[i] && s->missed[i] > SF_MISSED * s->offered[i];
    }
    for (int i = 0; i < K; i++) {
        int count = 0;
        for (int j = 0; j < K; j++) count += still[j] && c->together[i * K + j];
        /* Of two on a plate nobody knows: a third one that shows too much looks like them. */
        idle[i] = still[i] && count < 2;
        if (!enough[i]) continue;
        if (s->shown[i] >= SF_IDLE * SF_IDLE * s->expected[i]) s->alive[i] = 1;
        s->shown[i] = s->expected[i] = s->missed[i] = s->offered[i] = 0;
        any = any || (idle[i] && s->alive[i] < (sf_real)0.5);
    }
    /* Shares were learnt with it. */
    if (any) sf_copy(s->moments, c->prior, K * K);
    return any;
}

/* ChannelFaults.silent: find channels that are silent, always read the same, or bear nothing of their plate's load; return
   whether one was dead from the start. Of n samples, `width` numbers apart: forces by the starting map in `unit` N, and whether they
   were read. */
SF_API int sf_silent(const sf_config *c, sf_channel_faults *s, const sf_real *force, const sf_real *read, int width, int n,
                      sf_real unit) {
    int K = c->channels, flat[SF_CHANNELS], moves[SF_CHANNELS], again[SF_CHANNELS];
    int fresh[SF_CHANNELS], kind[SF_CHANNELS], stuck[SF_CHANNELS], idle[SF_CHANNELS];
    sf_real high[SF_CHANNELS], share[SF_CHANNELS], level[SF_CHANNELS], most = 0;
    for (int i = 0; i < K; i++) {
        sf_real low = high[i] = unit * force[i];
        share[i] = level[i] = 0;
        for (int t = 0; t < n; t++) {
            level[i] += unit * force[t * width + i];
            high[i] = sf_max(high[i], unit * force[t * width + i]);
            low = sf_min(low, unit * force[t * width + i]);
            share[i] += read[t * width + i];
        }
        share[i] /= (sf_real)n;
        level[i] /= (sf_real)n * c->weight;
        most = sf_max(most, share[i]);
        flat[i] = high[i] - low == 0;
        moves[i] = high[i] - low > SF_MOVING * c->weight;
        again[i] = share[i] > SF_ALL_READ && !flat[i] && (s->kind[i] & SF_MISSING) && s->lost[i] > (sf_real)0.5;
    }
    sf_return(c, s, again);
    int any = sf_compare_with_plate(c, s, level, idle);
    for (int i = 0; i < K; i++) {
        int moving = 0, missing = share[i] < SF_MOSTLY_MISSING && most >= SF_MOSTLY_MISSING && s->leapt[i] < SF_ONCE;
        for (int j = 0; j < K; j++)
            moving = moving || (j != i && moves[j] && c->foot_of_channel[j] == c->foot_of_channel[i]);
        stuck[i] = flat[i] && moving && share[i] > SF_ALL_READ;
        int dead = stuck[i] && sf_fabs(high[i]) <= SF_NO_LOAD * c->weight;
        int rail = stuck[i] && !dead && sf_fabs(high[i]) > SF_HEAVIEST * c->weight;
        kind[i] = (dead ? SF_DEAD : 0) | (rail ? SF_SATURATED : 0) |
                  (stuck[i] && !dead && !rail ? SF_STUCK : 0) | (missing ? SF_MISSING : 0);
        if (idle[i] && !kind[i]) kind[i] = SF_DEAD;
        fresh[i] = (stuck[i] || missing || idle[i]) && s->lost[i] < (sf_real)0.5 && c->cells[i];
    }
    sf_lose(c, s, fresh, kind);
    return any;
}

/* ChannelFaults.learn: how cells share loads while nothing is wrong; let channels come back. force: calibrated, by the
   channels' own readings in N, shape (groups, K); good: whether they could be learnt from, and nothing is in doubt. */
SF_API void sf_fault_learn(const sf_config *c, sf_channel_faults *s, const sf_real *force, int groups, int good) {
    int K = c->channels, back[SF_CHANNELS], any = 0, well = good && sf_all_there(c, s);
    for (int i = 0; well && i < K; i++)
        for (int j = 0; j < K; j++) {
            sf_real seen = 0;
            for (int g = 0; c->together[i * K + j] && g < groups; g++)
                seen += force[g * K + i] / c->weight * (force[g * K + j] / c->weight);
            s->moments[i * K + j] += c->renewal * (seen / (sf_real)groups - s->moments[i * K + j]);
        }
    if (!s->altered) return;
    for (int i = 0; i < K; i++) {
        sf_real error = 0, load = 0, high = 0, low = 0;
        for (int g = 0; g < groups; g++) {
            sf_real expected = sf_dot(s->spare + i * K, force + g * K, K);
            error = sf_max(error, sf_fabs(expected - force[g * K + i]));
            load = sf_max(load, sf_fabs(expected));
            high = g ? sf_max(high, expected) : expected;
            low = g ? sf_min(low, expected) : expected;
        }
        int moved = high - low > SF_AGREE * c->weight;
        int near = error < SF_AGREE * c->weight + SF_AGREE_SHARE * load;
        s->agreed[i] = (near ? s->agreed[i] + (sf_real)moved : 0) * s->lost[i];
        back[i] = s->agreed[i] >= SF_RETURN_BLOCKS && s->lost[i] > (sf_real)0.5;
        any = any || back[i];
    }
    for (int i = 0; any && i < K; i++)
        if (back[i]) s->agreed[i] = 0;
    if (any) sf_return(c, s, back);
}

#endif
