/* Feeds garbage to surefoot_beliefs.h and surefoot_view.h: `fuzz_beliefs SAMPLES`. They must stay within their arrays,
   which sanitizers watch, and know the robot's motion again half a second after packets are sound. */

#include <stdio.h>
#include <stdlib.h>

#include "robot.h"

#include "surefoot_view.h"

static sf_real any(void) {
    static const double all[] = {NAN, HUGE_VAL, -HUGE_VAL, 1e30, -1e7, 1e-30, 50.0};
    return (sf_real)all[rand() % 7];
}

int main(int count, char **words) {
    static sf_beliefs beliefs;
    static sf_config config;
    static sf_held held;
    sf_whole number = 0;
    long samples = count == 2 ? atol(words[1]) : 0, known = 0;
    sf_view view = {200, 1, 52, 0, 0};
    config.channels = SF_CHANNELS;
    config.feet = SF_FEET;
    if (!sf_beliefs_fit(&model, &timing)) return 1;
    sf_beliefs_init(&beliefs);
    for (long k = 0; k < samples; k++) {
        int calm = k % 1000 > 500;
        sf_real angle[SF_HINGES + 1], inertial[6];
        sf_belief belief;
        static sf_estimate estimate;
        static sf_shown shown;
        sf_real soles[4 * SF_FEET];
        unsigned char planned[4];
        double time = (double)number * timing.period;
        for (int i = 0; i < model.hinges; i++) angle[i] = (sf_real)(rand() % 100 * 0.001);
        for (int i = 0; i < 6; i++) inertial[i] = (sf_real)(rand() % 10 * 0.01) + (i == 2 ? (sf_real)9.81 : 0);
        if (!calm && rand() % 20 == 0) angle[rand() % SF_HINGES] = any();
        if (!calm && rand() % 20 == 0) inertial[rand() % 6] = any();
        /* Packets get lost, come twice, and are numbered anew. */
        number = calm || rand() % 20 ? number + 1 : rand() % 2 ? number + rand() % 200 - 100 : rand() - RAND_MAX / 2;
        sf_beliefs_packet(&model, &timing, &beliefs, number, (double)number * timing.period + timing.delay, angle,
                          inertial, inertial + 3);
        for (int i = 0; i < 4; i++) planned[i] = (unsigned char)(rand() % 2);
        if (!calm && rand() % 20 == 0) time = (double)any();
        sf_beliefs_sample(&timing, &beliefs, time, rand() % 2 ? planned : NULL, rand() % 50 == 0, &belief);
        sf_beliefs_soles(&timing, &beliefs, time, soles);
        for (int i = 0; i < SF_CHANNELS; i++) estimate.force[i] = calm ? 6 : any();
        for (int i = 0; i < 12; i++) estimate.wrench[i] = calm ? 6 : any();
        estimate.cop_valid = estimate.cop_foot_valid[0] = (unsigned char)calm;
        sf_view_show(&config, &view, &held, &estimate, soles, &shown);
        if (k % 1000 > 900) {
            known += belief.known;
            for (int i = 0; i < 3; i++)
                if (!sf_finite(beliefs.strapdown.ground[i]) || (belief.known && !sf_finite(belief.reference.com_acceleration[i])))
                    return 2;
            for (int i = 0; i < 2; i++)
                if (!sf_finite((sf_real)shown.cop[i])) return 3;
        }
    }
    printf("%ld known of %ld\n", known, samples);
    return known > samples / 20 ? 0 : 4;
}
