// One axis at 20 kHz on a board of the STM32 core for Arduino (STM32F4 or faster).
// Copy piezo_params.h, piezoid_runtime.h and piezoid_runtime.c of bundle/ beside this file, and
// define PZ_REAL_FLOAT in build_opt.h: -DPZ_REAL_FLOAT -ffp-contract=off
//
// analogRead and analogWrite of the core take some microseconds each: measure worst_us before you
// connect a stage. It must stay well below the period of 50 us.

#include "piezo_params.h"
#include "piezoid_runtime.h"

const int AXIS = 0;
const float SENSOR_m_PER_CODE = 1e-8f;   // yours
const float DRIVE_V_PER_CODE = 2.44e-3f; // yours: 10 V over 12 bits, behind your amplifier

pz_state state;
volatile float reference_m;
volatile uint32_t worst_us;
HardwareTimer timer(TIM2);

void step() {
    const uint32_t begun = micros();
    const float measured_m = analogRead(A0) * SENSOR_m_PER_CODE;
    const float voltage_V = pz_step(&state, &piezo_params[AXIS], reference_m, measured_m);
    analogWrite(PA4, (int)(voltage_V / DRIVE_V_PER_CODE + 0.5f));
    const uint32_t taken = micros() - begun;
    worst_us = taken > worst_us ? taken : worst_us;
}

void setup() {
    Serial.begin(115200);
    analogReadResolution(12);
    analogWriteResolution(12);
    analogWrite(PA4, 0);
    const float measured_m = analogRead(A0) * SENSOR_m_PER_CODE;
    if (pz_start(&state, &piezo_params[AXIS], 0.0f, measured_m) != PZ_OK) {
        Serial.println("pz_check refuses these parameters");
        return;
    }
    reference_m = measured_m;
    timer.setOverflow(20000, HERTZ_FORMAT);
    timer.attachInterrupt(step);
    timer.resume();
}

// A number over the serial line is the new reference in micrometres.
void loop() {
    if (Serial.available() > 0) {
        reference_m = Serial.parseFloat() * 1e-6f;
    }
    Serial.print("status ");
    Serial.print(state.status);
    Serial.print(", worst step in us ");
    Serial.println(worst_us);
    delay(500);
}
