/* Feed random garbage to the tare: `fuzz_native CONFIG SAMPLES` reads the constants of one robot, and of the tare,
   as bytes. It fails with a message and status 1 if the state or an estimate is ever not finite. Sanitizers check
   memory accesses. */

#include <stdio.h>
#include <stdlib.h>

#include <string.h>

#include "surefoot_tare.h"

static unsigned long long bits = 88172645463325252ULL;

static double uniform(void) {
    bits ^= bits << 13;
    bits ^= bits >> 7;
    bits ^= bits << 17;
    return (double)(bits >> 11) / 9007199254740992.0;
}

static int chance(double share) { return uniform() < share; }

static sf_real poison(void) {
    static const double all[] = {NAN, HUGE_VAL, -HUGE_VAL, 3e38, -3e38, 0.0, 1e-30, 8.4e6, -5.0, 1e3, 60.0};
    return (sf_real)all[(int)(uniform() * 11.0)];
}

static void spoil(sf_real *values, int n, double share) {
    for (int i = 0; i < n; i++)
        if (chance(share)) values[i] = poison();
}

int main(int count, char **words) {
    static sf_config config;
    static sf_tare_config tare;
    static sf_tare_state tared;
    static sf_estimate estimate;
    FILE *file = count == 3 ? fopen(words[1], "rb") : NULL;
    if (!file || fread(&config, sizeof config, 1, file) != 1) return 2;
    if (fread(&tare, sizeof tare, 1, file) != 1 || !sf_robot_fits(&config)) return 2;
    fclose(file);
    sf_tare_init(&config, &tared);
    long samples = atol(words[2]);
    int K = config.channels, broken = -1, kind = 0;
    for (long k = 0; k < samples; k++) {
        sf_reference reference = {{0, 0, (sf_real)0.26}, {0, 0, 0}, {0, 0, 0}, {0}, {0}, {1, 1}, {0, 0}, 0};
        sf_real raw[SF_CHANNELS], phase = (sf_real)sin((double)k * 0.05),
                                  share = (1 + phase * (sf_real)1.2) / 2;
        share = sf_clip(share, 0, 1);
        for (int foot = 0; foot < config.feet; foot++) {
            sf_real part = foot ? 1 - share : share;
            reference.position_sole[3 * foot + 1] = (sf_real)(foot ? -0.05 : 0.05);
            for (int i = 0; i < 3; i++) reference.R_level_sole[9 * foot + 4 * i] = 1;
            reference.stance[foot] = part > 0;
            reference.swing[foot] = part <= 0;
            for (int i = 0; i < K; i++)
                if (config.foot_of_channel[i] == foot)
                    raw[i] = part * config.weight *
                             (sf_real)(0.25 + 0.05 * (uniform() - 0.5) + 0.1 * sin(0.01 * (double)(k * i)));
        }
        reference.com[1] = (share - (sf_real)0.5) * (sf_real)0.1;
        /* For some hundred samples one channel is broken, in one way or another. */
        if (k % 700 == 0) broken = chance(0.5) ? (int)(uniform() * K) : -1, kind = (int)(uniform() * 4);
        if (broken >= 0)
            raw[broken] = kind == 0   ? -raw[broken]
                          : kind == 1 ? 1
                          : kind == 2 ? (sf_real)NAN
                                      : 3 * raw[broken];
        if (k % 4000 < 3000) {
            spoil(raw, K, 0.003);
            spoil(reference.com, 3, 0.001);
            spoil(reference.com_acceleration, 3, 0.001);
            spoil(reference.angular_momentum_rate, 3, 0.001);
            spoil(reference.R_level_sole, 9 * config.feet, 0.0005);
            spoil(reference.position_sole, 3 * config.feet, 0.0005);
            if (chance(0.02)) reference.swing[0] = reference.swing[config.feet - 1] = 1;
        }
        sf_real dt = chance(0.001) ? poison() : config.dt;
        sf_tare_step(&config, &tare, &tared, raw, &reference, dt, &estimate);
        if (chance(0.0005)) sf_tare_begin(&config, &tared);
        if (k % 20000 == 0) sf_tare_init(&config, &tared);
        if (!sf_all_finite(tared.offset, K) || !sf_all_finite(tared.scatter, K) ||
            !sf_all_finite(estimate.force, K) || !sf_all_finite(estimate.wrench, 6 * config.feet) ||
            sf_finite(estimate.cop[0]) != estimate.cop_valid) {
            printf("not finite at sample %ld\n", k);
            return 1;
        }
    }
    printf("%ld samples\n", samples);
    return 0;
}
