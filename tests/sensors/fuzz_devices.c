/* Feeds garbage to a device: `fuzz_devices CONFIG STATE SAMPLES` reads its constants and its state as bytes. It must stay within
   its arrays, which sanitizers watch, and what it remembers must leave readings finite once loads are again. */

#include <stdio.h>
#include <stdlib.h>

#include "surefoot_feet.h"

#if defined FORCE_TORQUE
typedef sf_force_torque_config constants;
typedef sf_force_torque memory;
#define FITS sf_force_torque_fits
#define STEP(load, dt) sf_force_torque_step(&config, &state, &stream, load, dt, counts)
#define FELT (SF_AXES * config.sensors)
#define CHANNELS FELT
#elif defined STRAIN_GAUGES
typedef sf_strain_gauges_config constants;
typedef sf_strain_gauges memory;
#define FITS sf_strain_gauges_fits
#define STEP(load, dt) sf_strain_gauges_step(&config, &state, &stream, load, dt, counts)
#define FELT SF_AXES
#define CHANNELS config.channels
#elif defined FAULTS
typedef sf_faults_config constants;
typedef sf_faults memory;
#define FITS sf_faults_fits
#define STEP(load, dt) (memcpy(counts, load, FELT * sizeof *load), sf_faults_step(&config, &state, &stream, dt, counts))
#define FELT config.channels
#define CHANNELS FELT
#else
typedef sf_cells_config constants;
typedef sf_cells memory;
#define FITS sf_cells_fits
#define STEP(load, dt) read_feet(load, dt, k % 97 == 0)
#define FELT (SUBSTEPS * sf_loads(&config))
#define CHANNELS config.channels
#endif
#define SUBSTEPS 5

static constants config;
static memory state;
static sf_random stream = {7, 0};
static sf_real counts[SF_LOAD_CELLS];

#ifdef CELLS
/* By all that is under the feet, with an episode's start now and then. */
static void read_feet(const sf_real *load, sf_real dt, int begins) {
    static const int order[SF_LOAD_CELLS] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
    sf_feet feet;
    memset(&feet, 0, sizeof feet);
    feet.cells_config = &config, feet.cells = &state, feet.cells_stream = &stream;
    feet.order = order, feet.dt = feet.first = dt, feet.more = 3;
    if (begins)
        sf_feet_begin(&feet, load, SUBSTEPS, NULL, counts);
    else
        sf_feet_step(&feet, load, SUBSTEPS, NULL, counts);
}
#endif

static int fill(const char *name, void *record, size_t size) {
    FILE *file = fopen(name, "rb");
    int filled = file && fread(record, size, 1, file) == 1;
    if (file) fclose(file);
    return filled;
}

int main(int count, char **names) {
    static const double all[] = {NAN, HUGE_VAL, -HUGE_VAL, 3e38, -3e38, 1e-30, 0.0, -0.0, 1e6, -1e6};
    static sf_real load[3 * SUBSTEPS * SF_LOAD_CELLS];
    if (count != 4 || !fill(names[1], &config, sizeof config) || !fill(names[2], &state, sizeof state)) return 1;
    if (!FITS(&config)) return 2;
    long samples = atol(names[3]);
    int arrived = 0;
    for (long k = 0; k < samples; k++) {
        int calm = k % 1000 > 500;
        for (int i = 0; i < FELT; i++)
            load[i] = (sf_real)(!calm && rand() % 20 == 0 ? all[rand() % 10] : rand() % 1000 * 0.1);
        STEP(load, (sf_real)(calm || rand() % 20 ? 0.0125 : rand() % 100 * 0.002));
        /* What the wire brings may have been lost on it, and be older than the load. */
        for (int i = 0; i < CHANNELS && k % 1000 > 900; i++) arrived += isfinite(counts[i]) != 0;
    }
    if (!arrived) printf("no reading is finite after garbage\n");
    return arrived ? 0 : 3;
}
