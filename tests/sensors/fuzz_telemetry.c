/* Feeds garbage to surefoot_telemetry.h: it must stay within its arrays, and its belief of what is up finite. */

#include <stdio.h>
#include <stdlib.h>

#include "surefoot_telemetry.h"

static sf_telemetry_config config;
static sf_telemetry state;
static sf_real arrived[SF_LINK_ROOM * SF_PACKET];
static sf_real truth[16 * (SF_JOINTS + 6)];

static sf_real any(void) {
    return (sf_real)(rand() % 2000 - 1000) * (rand() % 50 ? (sf_real)0.01 : (sf_real)1e4);
}

int main(int count, char **names) {
    FILE *file = fopen(names[count - 1], "rb");
    sf_random stream = {7, 0};
    if (!file || fread(&config, sizeof config, 1, file) != 1 || !sf_telemetry_fits(&config)) return 1;
    for (int k = 0; k < 5000; k++) {
        for (unsigned i = 0; i < sizeof truth / sizeof *truth; i++) truth[i] = any();
        int come =
            k % 1000 ? sf_telemetry_advance(&config, &state, truth, truth, k * config.dt, &stream, arrived)
                     : sf_telemetry_init(&config, &state, truth, truth, k % 2000 == 0, &stream, arrived);
        if (come < -1 || come > SF_LINK_ROOM) return 2;
        for (int i = 0; i < 3; i++)
            if (state.up[i] - state.up[i] != 0) return 3;
    }
    return 0;
}
