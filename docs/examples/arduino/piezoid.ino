// One axis at 20 kHz on a board of the STM32 core for Arduino (STM32F4 or faster).
// Copy piezo_params.h, piezoid_runtime.h and piezoid_runtime.c of bundle/ beside this file, and
// define PZ_REAL_FLOAT in build_opt.h: -DPZ_REAL_FLOAT -ffp-contract=off
//
// analogRead and analogWrite of the core take some microseconds each: read worst_us before you
// connect a stage. It must stay well below the period of 50 us.

#include "piezo_params.h"
#include "piezoid_runtime.h"

const int AXIS = 0; // a position axis: a tip may retract below 0 V, which the pin cannot
static_assert(((PIEZO_TIP_AXES >> AXIS) & 1u) == 0u, "this sketch is for position axes only");
// To be adapted. The sensor has the scale, zero and sign of the recordings.
const float SENSOR_m_PER_CODE = 1e-8f;
// Volts at the input of the high-voltage amplifier for one code: here a buffer makes 0 to 10 V of
// the 0 to 3.3 V of the pin.
const float DRIVE_V_PER_CODE = 2.44140625e-3f;
const int DRIVE_MAX_CODE = 4095;
const int RATE_Hz = 20000;

pz_state state;
const int RAMP_SAMPLES = 2000; // for the whole range of the reference
float reference_m;             // starts at the first reading, and ramps to:
volatile float wanted_m;
volatile uint32_t worst_us;
HardwareTimer timer(TIM2);

// Saturated: the pin has no voltage beyond its last code.
static int drive_code(float voltage_V) {
    const float code = voltage_V / DRIVE_V_PER_CODE + 0.5f;
    if (code < 0.0f) {
        return 0;
    }
    return code < (float)DRIVE_MAX_CODE ? (int)code : DRIVE_MAX_CODE;
}

static void ramp_reference() {
    const pz_parameters &p = piezo_params[AXIS];
    const float step_m = (p.reference_maximum_m - p.reference_minimum_m) / RAMP_SAMPLES;
    const float goal_m = wanted_m;
    const float distance_m = goal_m - reference_m;
    if (distance_m > step_m || distance_m < -step_m) {
        reference_m += distance_m > 0.0f ? step_m : -step_m;
    } else {
        reference_m = goal_m;
    }
}

void step() {
    const uint32_t begun = micros();
    ramp_reference();
    const float measured_m = analogRead(A0) * SENSOR_m_PER_CODE;
    const float voltage_V = pz_step(&state, &piezo_params[AXIS], reference_m, measured_m);
    analogWrite(PA4, drive_code(voltage_V));
    const uint32_t taken = micros() - begun;
    worst_us = taken > worst_us ? taken : worst_us;
}

// Raise the drive from 0 V until the reading lies within the references: a controller that starts
// outside would jump there. Returns the voltage.
static float rise() {
    const pz_parameters &p = piezo_params[AXIS];
    float voltage_V = 0.0f;
    for (int code = 0; code <= DRIVE_MAX_CODE; ++code) {
        voltage_V = (float)code * DRIVE_V_PER_CODE;
        analogWrite(PA4, code);
        delay(1);
        const float measured_m = analogRead(A0) * SENSOR_m_PER_CODE;
        if (voltage_V >= p.voltage_maximum_V ||
            (measured_m >= p.reference_minimum_m && measured_m <= p.reference_maximum_m)) {
            break;
        }
    }
    return voltage_V;
}

void setup() {
    Serial.begin(115200);
    analogReadResolution(12);
    analogWriteResolution(12);
    if (piezo_params[AXIS].sampling_rate_Hz != RATE_Hz) {
        Serial.println("the bundle is for another rate");
        return;
    }
    const float voltage_V = rise();
    const float measured_m = analogRead(A0) * SENSOR_m_PER_CODE; // waits for the conversion
    if (pz_start(&state, &piezo_params[AXIS], voltage_V, measured_m) != PZ_OK) {
        Serial.println("pz_check refuses these parameters");
        return;
    }
    reference_m = state.reference_m;
    wanted_m = reference_m;
    timer.setOverflow(RATE_Hz, HERTZ_FORMAT);
    timer.attachInterrupt(step);
    timer.resume();
}

// The reference ramps to a number, in micrometres, on the serial line.
void loop() {
    if (Serial.available() > 0) {
        wanted_m = Serial.parseFloat() * 1e-6f;
    }
    Serial.print("status ");
    Serial.print(state.status);
    Serial.print(", worst step in us ");
    Serial.println(worst_us);
    delay(500);
}
