// One foot on 1 to 8 load cells with an HX711 each: forces, centre of pressure, tares, drift of zeros, faults.
//
//     #define SUREFOOT_CELLS 4           // before the include; 4 by default
//     #include <SurefootFoot.h>
//
//     const float x[] = {0.11, 0.11, -0.06, -0.06}, y[] = {0.05, -0.05, 0.05, -0.05};   // m in the sole's frame
//     SurefootFoot foot(x, y, 52.0, 80);                        // N that the foot bears at most times, readings a second
//     foot.setScale(0, 2.1e-5);                                 // N per count, a cell
//     foot.tare();                                              // it hangs now: its zeros are what it reads
//     foot.update(counts);                                      // once a conversion; SurefootFoot::NONE for none
//     foot.force(0); foot.load(); foot.x(); foot.y(); foot.hasCop(); foot.faults(0);
//
// Zeros drift. They are followed while the foot hangs: as the robot says by hangs(true), or by itself while no cell bears
// more than followBelow(N). It is the swing tare of surefoot_tare.h, with its checks: it rejects readings that spread or
// are far from the last zeros. A foot that seems to pull at the ground was tared under load: it has the fault REJECTED, and
// with followBelow() it is tared again as soon as it hangs still.

#ifndef SUREFOOT_FOOT_H
#define SUREFOOT_FOOT_H

#ifndef SUREFOOT_CELLS
#define SUREFOOT_CELLS 4
#endif
#if SUREFOOT_CELLS < 1 || SUREFOOT_CELLS > 8
#error "SUREFOOT_CELLS is a number from 1 to 8"
#endif
#define SF_SINGLE
#define SF_CHANNELS SUREFOOT_CELLS
#define SF_FEET 1
#define SF_LAG 0
#include <limits.h>

#include "surefoot_tare.h"

class SurefootFoot {
public:
    static const int CELLS = SUREFOOT_CELLS;
    static const long NONE = LONG_MIN;  // a reading that did not arrive

    // Faults of a cell, as bits: no reading came, a reading at an end of the converter, one that leapt away alone and was
    // held, always the same reading, a tare that was rejected or made under load, an impossible time between readings.
    enum Fault {
        MISSING = SF_MISSING,
        RAILED = SF_SATURATED,
        SPIKE = SF_SPIKE,
        DEAD = SF_DEAD,
        REJECTED = SF_REJECTED,
        GAP = SF_GAP
    };

    // x, y: places of the cells in the sole's frame in m. weight: what the foot bears at most times, N. rate: readings of
    // a cell a second. threshold: load in N above which there is a centre of pressure.
    SurefootFoot(const float *x, const float *y, float weight, float rate, float threshold = 5) {
        config_.channels = CELLS;
        config_.feet = 1;
        config_.dt = 1 / rate;
        config_.weight = weight;
        config_.force_threshold = threshold;
        config_.longest_silence = fmaxf(SILENCE, (float)SF_LONGEST_GAP / rate);
        config_.leap = fmaxf(LEAP, LEAP_RATE / rate) * weight;
        for (int i = 0; i < CELLS; i++) {
            config_.wrench_map[SF_FZ * CELLS + i] = 1;
            config_.wrench_map[SF_MX * CELLS + i] = y[i];
            config_.wrench_map[SF_MY * CELLS + i] = -x[i];
            config_.scale[i] = 1;
            config_.lowest[i] = -END;
            config_.highest[i] = END;
        }
        tare_.settle = (int)(SETTLE * rate + 0.5f);
        tare_.minimum_samples = FEWEST;
        tare_.spread = SPREAD * weight;
        longest_ = (int)(SWING * rate);
        for (int i = 0; i < 9; i += 4) reference_.R_level_sole[i] = 1;
        begin();
    }

    // Newtons per count of a cell, and its zero in N: force = scale count + offset. Begins again.
    void setScale(int cell, float scale) { setMap(cell, scale, config_.offset[cell]); }
    void setMap(int cell, float scale, float offset) {
        config_.scale[cell] = scale;
        config_.offset[cell] = offset;
        begin();
    }

    // The foot hangs from now on: take its zeros, however far they are, of the first so many seconds in which it is still.
    void tare(float seconds = 0.5f) {
        longest_ = tare_.settle + 1 + (int)fmaxf(seconds / config_.dt, FEWEST);
        swing_ = longest_;
        taring_ = true;
    }
    bool taring() const { return taring_; }

    // Whether the robot knows that the foot is in the air.
    void hangs(bool inAir) { hangs_ = inAir; }

    // The foot hangs while neither it nor any of its cells bears more than this, N; 0 leaves that to hangs().
    void followBelow(float load) { follow_ = load; }

    // Take in one reading of each cell. dt: time since the last ones in s, the nominal one by default.
    void update(const long *counts, float dt = 0) {
        sf_real raw[CELLS];
        check(counts, raw);
        // A long swing is many short ones: zeros that drift are not averaged over all of it.
        const bool unloaded = follow_ > 0 && bearsAtMost(follow_), pulls = !taring_ && load() < -LIMIT * config_.weight;
        if (pulls && unloaded) tare();
        const bool inAir = taring_ || hangs_ || unloaded;
        swing_ = inAir && swing_ < longest_ ? swing_ + 1 : 0;
        reference_.swing[0] = swing_ > 0;
        tare_.limit = taring_ ? INFINITY : LIMIT * config_.weight;
        sf_tare_step(&config_, &tare_, &state_, raw, &reference_, dt > 0 ? dt : config_.dt, &estimate_);
        bool moved = false;
        for (int i = 0; i < CELLS; i++) {
            const unsigned flags = (unsigned)estimate_.flags[i];
            // What was left out says why by itself.
            faults_[i] |= flags & (faults_[i] ? SF_GAP | SF_REJECTED : SF_MISSING | SF_GAP | SF_REJECTED);
            moved = moved || flags & SF_REJECTED;
            // No sole pulls: its zeros were taken under load.
            if (pulls) faults_[i] |= REJECTED;
        }
        if (taring_ && swing_ == longest_ && !moved) rebase();
    }

    float force(int cell) const { return estimate_.force[cell]; }      // N
    float load() const { return estimate_.wrench[SF_FZ]; }             // N, of all cells
    bool hasCop() const {  // without load, with a cell at its rail or dead, or silent for 0.25 s, there is none
        for (int i = 0; i < CELLS; i++)
            if (faults_[i] & (RAILED | DEAD)) return false;
        return estimate_.cop_foot_valid[0];
    }
    float x() const { return hasCop() ? estimate_.cop_foot[0] : NAN; }  // m in the sole's frame, NaN without a CoP
    float y() const { return hasCop() ? estimate_.cop_foot[1] : NAN; }
    unsigned faults(int cell) const { return faults_[cell]; }          // bits of Fault
    float scale(int cell) const { return config_.scale[cell]; }        // N per count
    float offset(int cell) const { return config_.offset[cell] + state_.offset[cell]; }  // N, for setMap() after a restart

private:
    // Of the swing tare and of leaps, as in Python: SwingTare in calibration/baselines.py, LEAP and LEAP_RATE in
    // calibration/moment/filter.py. In s, readings, and weights.
    static constexpr float SETTLE = 0.05f, SPREAD = 0.01f, LIMIT = 0.2f, LEAP = 0.25f, LEAP_RATE = 40.0f;
    static const int FEWEST = 10;
    // In s, as LONGEST_SILENCE in calibration/front_end/readings.py.
    static constexpr float SILENCE = 0.25f;
    // The ends of 24 bits, at which an HX711 stands that is driven too far.
    static constexpr float END = 8388606;
    // Readings in a row that are the same: an HX711's noise is some 40 counts, of which two in a row are equal once in
    // 140, and eight once in 10^15.
    static const unsigned char SAME = 8;
    // After how many seconds a tare begins anew while the foot hangs.
    static constexpr float SWING = 1;

    void begin() {
        sf_tare_init(&config_, &state_);
        for (int i = 0; i < CELLS; i++) leaps_[i] = SF_LONGEST_LEAP, last_[i] = 0;
    }

    bool bearsAtMost(float most) const {
        bool below = load() < most;
        for (int i = 0; i < CELLS; i++) below = below && force(i) < most;
        return below;
    }

    // Zeros of a tare become those of the map, about which later ones may drift.
    void rebase() {
        for (int i = 0; i < CELLS; i++) config_.offset[i] += state_.offset[i];
        begin();
        taring_ = false;
        longest_ = (int)(SWING / config_.dt);
    }

    // Replace what is not a reading by NaN.
    void check(const long *counts, sf_real *raw) {
        float step[CELLS];
        for (int i = 0; i < CELLS; i++) {
            const float count = (float)counts[i];
            const bool there = counts[i] != NONE;
            same_[i] = there && counts[i] == before_[i] ? (same_[i] < SAME ? same_[i] + 1 : SAME) : 1;
            before_[i] = counts[i];
            const bool railed = there && (count > END || count < -END), dead = same_[i] == SAME;
            faults_[i] = (railed ? RAILED : 0) | (dead && !railed ? DEAD : 0);
            raw[i] = there && !railed && !dead ? count : NAN;
            step[i] = raw[i] == raw[i] ? fabsf(config_.scale[i] * (count - last_[i])) : 0;
        }
        for (int i = 0; i < CELLS; i++) {
            // A foot that lands moves several of its cells.
            float others = 0;
            for (int j = 0; j < CELLS; j++)
                if (j != i) others = fmaxf(others, step[j]);
            const bool leaps = raw[i] == raw[i] && leaps_[i] < LONGEST && step[i] > config_.leap && step[i] > SF_ALONE * others;
            if (leaps) raw[i] = NAN, faults_[i] |= SPIKE, leaps_[i]++;
            else if (raw[i] == raw[i]) leaps_[i] = 0, last_[i] = raw[i];
        }
    }

    // A single cell has no others that tell a landing from a spike: it is held for one reading.
    static const int LONGEST = CELLS > 1 ? SF_LONGEST_LEAP : 1;

    sf_config config_ = sf_config();
    sf_tare_config tare_ = sf_tare_config();
    sf_tare_state state_;
    sf_reference reference_ = sf_reference();
    sf_estimate estimate_ = sf_estimate();
    long before_[CELLS] = {};
    float last_[CELLS], follow_ = 0;
    unsigned faults_[CELLS] = {};
    unsigned char leaps_[CELLS], same_[CELLS] = {};
    int swing_ = 0, longest_;
    bool taring_ = false, hangs_ = false;
};

#endif
