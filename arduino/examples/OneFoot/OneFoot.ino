// One foot on four load cells: its load, centre of pressure and faults, ten times a second.
// Needs the library "HX711 Arduino Library" (bogde/HX711), with each chip at 80 readings a second (pin RATE high).

#include <HX711.h>

#define SUREFOOT_CELLS 4
#include <SurefootFoot.h>

const byte DATA[] = {2, 3, 4, 5}, CLOCK[] = {6, 7, 8, 9};
// Front left, front right, rear left, rear right, in m in the sole's frame: x forward, y to the left.
const float X[] = {0.11, 0.11, -0.06, -0.06}, Y[] = {0.05, -0.05, 0.05, -0.05};
const float SCALE[] = {2.1e-5, 2.0e-5, 2.1e-5, 2.2e-5};  // N per count, of known weights

HX711 cell[SUREFOOT_CELLS];
SurefootFoot foot(X, Y, 52.0, 80);  // a robot of 5.3 kg
byte lines = 0;

void setup() {
    Serial.begin(115200);
    for (byte i = 0; i < SUREFOOT_CELLS; i++) {
        cell[i].begin(DATA[i], CLOCK[i]);
        foot.setScale(i, SCALE[i]);
    }
    foot.tare();           // nothing stands on it now
    foot.followBelow(2.0);  // in N: lighter than that it hangs, and its zeros are followed
}

void loop() {
    long counts[SUREFOOT_CELLS];
    if (!cell[0].is_ready()) return;
    for (byte i = 0; i < SUREFOOT_CELLS; i++)
        counts[i] = cell[i].wait_ready_timeout(5) ? cell[i].read() : SurefootFoot::NONE;
    foot.update(counts);
    if (Serial.read() == 't') foot.tare();
    if (++lines % 8) return;
    Serial.print(foot.load(), 2);
    Serial.print(" N, ");
    Serial.print(1000 * foot.x(), 1);
    Serial.print(" ");
    Serial.print(1000 * foot.y(), 1);
    Serial.print(" mm");
    for (byte i = 0; i < SUREFOOT_CELLS; i++) {
        const unsigned faults = foot.faults(i);
        Serial.print(faults & SurefootFoot::DEAD ? " dead" : faults & SurefootFoot::RAILED ? " railed" : faults & SurefootFoot::SPIKE ? " spike"
                     : faults & SurefootFoot::MISSING ? " missing" : " ok");
    }
    Serial.println();
}
