/* One axis at 20 kHz on an STM32F405, without a vendor's library: a timer's interrupt reads the
 * sensor, steps the controller with a table of feedforward, and writes the converter.
 *
 *   arm-none-eabi-gcc -std=c99 -O2 -ffp-contract=off -mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 \
 *     -mfloat-abi=hard -DPZ_REAL_FLOAT -nostartfiles --specs=nosys.specs -T stm32f405.ld \
 *     -I bundle main.c bundle/piezoid_runtime.c -o controller.elf
 *
 * Sensor: ADC1, channel 0 (PA0), 12 bits. Drive: DAC channel 1 (PA4), 12 bits. For better
 * converters replace read_sensor_m and write_drive. Look at `worst_cycles` with a debugger; a step
 * that takes longer than a period sets `missed`.
 */
#include <math.h>
#include <stdint.h>

#include "piezo_params.h"
#include "piezoid_runtime.h"

/* To be adapted. The sensor has the scale, zero and sign of the recordings. Position axes only: a
 * tip may retract below 0 V, which this converter cannot put out. */
#define AXIS 0
#if (PIEZO_TIP_AXES >> AXIS) & 1u
#error "AXIS regulates a current: this program is for position axes only"
#endif
#define SENSOR_m_PER_CODE PZ_REAL(1e-8)
#define SENSOR_ZERO_m PZ_REAL(0)
/* Volts at the input of the high-voltage amplifier for one code: here a buffer makes 0 to 10 V of
 * the 0 to 3.3 V of the pin. */
#define DRIVE_V_PER_CODE PZ_REAL(2.44140625e-3)
#define DRIVE_MAX_CODE 4095u

#define CORE_Hz 168000000u
#ifndef TIMER_Hz
#define TIMER_Hz 84000000u /* of TIM2: twice the clock of its bus */
#endif
#define RATE_Hz 20000u
#define POINTS 400u        /* of a period: lines of 50 Hz */
#define RAMP_SAMPLES 2000u /* for the whole range, before the first line */
#define RISE_WAIT 10000u   /* turns of an empty loop for each DAC code: some 0.3 ms */

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define RCC(offset) REGISTER(0x40023800u + (offset))
#define FLASH_ACR REGISTER(0x40023C00u)
#define PWR_CR REGISTER(0x40007000u)
#define GPIOA_MODER REGISTER(0x40020000u)
#define TIM2(offset) REGISTER(0x40000000u + (offset))
#define ADC1(offset) REGISTER(0x40012000u + (offset))
#define ADC_CCR REGISTER(0x40012304u)
#define DAC(offset) REGISTER(0x40007400u + (offset))
#define NVIC_ENABLE_0 REGISTER(0xE000E100u)
#define COPROCESSORS REGISTER(0xE000ED88u)
#define SYSTICK_CONTROL REGISTER(0xE000E010u)
#define SYSTICK_RELOAD REGISTER(0xE000E014u)
#define SYSTICK_VALUE REGISTER(0xE000E018u)
#define SYSTICK_MASK 0x00FFFFFFu
#define TIM2_INTERRUPT 28u

extern uint32_t stack_top[], data_begin[], data_end[], data_stored[], bss_begin[], bss_end[];

void reset(void);
void on_timer(void);
int main(void);

/* Table of `piezoid learn`; zeros: no feedforward. */
static const pz_real feedforward_V[POINTS] = {0};
static pz_state state;
static pz_real reference_m; /* starts at the first reading */

volatile uint32_t steps, worst_cycles, sum_cycles, missed;

static void stop(void) {
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static void (*const vectors[16 + 29])(void) = {
    [0] = (void (*)(void))stack_top,  [1] = reset, [2] = stop, [3] = stop,
    [16 + TIM2_INTERRUPT] = on_timer,
};

static int conversion_ended(void) {
#ifdef PZ_EMULATED
    return 1; /* the emulated converter sets no flag */
#else
    return (ADC1(0x00) & 2u) != 0u;
#endif
}

/* Convert and wait, 27 cycles of 21 MHz. NaN, a reading that the controller does not use, if the
 * conversion does not end. */
static pz_real read_sensor_m(void) {
    ADC1(0x08) |= 1u << 30;
    for (uint32_t tries = 0; tries < 200u; ++tries) {
        if (conversion_ended()) {
            return (pz_real)(ADC1(0x4C) & 0xFFFu) * SENSOR_m_PER_CODE + SENSOR_ZERO_m;
        }
    }
    return (pz_real)NAN;
}

/* Saturated: the word of a code beyond the last one, cut to 12 bits, would be 0 V. */
static uint32_t drive_code(pz_real voltage_V) {
    const pz_real code = voltage_V / DRIVE_V_PER_CODE + PZ_REAL(0.5);
    if (code < PZ_REAL(0)) {
        return 0u;
    }
    return code < (pz_real)DRIVE_MAX_CODE ? (uint32_t)code : DRIVE_MAX_CODE;
}

static void write_drive(pz_real voltage_V) {
    DAC(0x08) = drive_code(voltage_V);
}

/* A triangle over the middle half of the references. */
static pz_real triangle_m(uint32_t point) {
    const pz_parameters *p = &piezo_params[AXIS];
    const uint32_t up = point < POINTS / 2u ? point : POINTS - point;
    const pz_real share = PZ_REAL(0.25) + (pz_real)up / (pz_real)POINTS;
    return p->reference_minimum_m + share * (p->reference_maximum_m - p->reference_minimum_m);
}

/* Raise the drive from 0 V until the reading lies within the references: a controller that starts
 * outside would jump there. Returns the voltage. */
static pz_real rise(void) {
    const pz_parameters *p = &piezo_params[AXIS];
    pz_real voltage_V = PZ_REAL(0);
    for (uint32_t code = 0; code < DRIVE_MAX_CODE; ++code) {
        const pz_real measured_m = read_sensor_m();
        voltage_V = (pz_real)code * DRIVE_V_PER_CODE;
        write_drive(voltage_V);
        if (voltage_V >= p->voltage_maximum_V ||
            (measured_m >= p->reference_minimum_m && measured_m <= p->reference_maximum_m)) {
            break;
        }
        for (volatile uint32_t wait = 0; wait < RISE_WAIT; ++wait) {
        }
    }
    return voltage_V;
}

/* Move the reference slowly from the first reading to the triangle. Returns 1 on the way. */
static int ramps_to(pz_real goal_m) {
    const pz_parameters *p = &piezo_params[AXIS];
    const pz_real step_m =
        (p->reference_maximum_m - p->reference_minimum_m) / (pz_real)RAMP_SAMPLES;
    const pz_real distance_m = goal_m - reference_m;
    if (distance_m > step_m || distance_m < -step_m) {
        reference_m += distance_m > PZ_REAL(0) ? step_m : -step_m;
        return 1;
    }
    return 0;
}

void on_timer(void) {
    static uint32_t point;
    static int is_on_triangle;
    const uint32_t ahead = (uint32_t)piezo_params[AXIS].preview_samples % POINTS;
    const uint32_t begun = SYSTICK_VALUE;
    pz_real table_V = PZ_REAL(0);
    TIM2(0x10) = 0; /* clears the flag of this interrupt */
    if (is_on_triangle || !ramps_to(triangle_m(ahead))) {
        is_on_triangle = 1;
        reference_m = triangle_m((point + ahead) % POINTS);
        table_V = feedforward_V[point];
        point = point + 1u < POINTS ? point + 1u : 0u;
    }
    write_drive(
        pz_step_feedforward(&state, &piezo_params[AXIS], reference_m, read_sensor_m(), table_V));
    const uint32_t taken = (begun - SYSTICK_VALUE) & SYSTICK_MASK;
    worst_cycles = taken > worst_cycles ? taken : worst_cycles;
    sum_cycles += taken;
    missed |= TIM2(0x10) & 1u; /* the next interrupt is due already */
    ++steps;
}

/* 8 MHz crystal to 168 MHz, buses at 42 and 84 MHz, five wait states with caches. */
static void start_clock(void) {
    PWR_CR |= 1u << 14;
    FLASH_ACR = 5u | 7u << 8;
    RCC(0x00) |= 1u << 16;
    while ((RCC(0x00) & 1u << 17) == 0u) {
    }
    RCC(0x04) = 8u | 336u << 6 | 0u << 16 | 1u << 22 | 7u << 24;
    RCC(0x00) |= 1u << 24;
    while ((RCC(0x00) & 1u << 25) == 0u) {
    }
    RCC(0x08) = 5u << 10 | 4u << 13 | 2u;
    while ((RCC(0x08) & 3u << 2) != 2u << 2) {
    }
}

static void start_converters(void) {
    RCC(0x30) |= 1u;             /* port A */
    RCC(0x40) |= 1u | 1u << 29;  /* TIM2 and DAC */
    RCC(0x44) |= 1u << 8;        /* ADC1 */
    GPIOA_MODER |= 3u | 3u << 8; /* PA0 and PA4 analogue */
    DAC(0x00) = 1u;              /* channel 1 on */
    ADC_CCR = 1u << 16;          /* 84 MHz / 4 */
    ADC1(0x10) = 1u;             /* 15 cycles of sampling, 12 of conversion */
    ADC1(0x08) = 1u;             /* on; stable after 3 us */
    for (volatile uint32_t wait = 0; wait < 1000u; ++wait) {
    }
}

static void start_timer(void) {
    SYSTICK_RELOAD = SYSTICK_MASK;
    SYSTICK_VALUE = 0;
    SYSTICK_CONTROL = 5; /* counts core cycles, without an interrupt */
    TIM2(0x28) = 0;
    TIM2(0x2C) = TIMER_Hz / RATE_Hz - 1u;
    TIM2(0x0C) = 1u;
    NVIC_ENABLE_0 = 1u << TIM2_INTERRUPT;
    TIM2(0x00) = 1u;
}

#ifdef PZ_EMULATED /* prints the counted instructions of an emulator */
#include <stdio.h>
extern void initialise_monitor_handles(void);
static void watch(void) {
    initialise_monitor_handles();
    while (steps < 4000u) {
    }
    printf("%lu %lu %lu %lu\n", (unsigned long)steps, (unsigned long)sum_cycles,
           (unsigned long)worst_cycles, (unsigned long)missed);
}
#else
static void watch(void) {
    stop();
}
#endif

int main(void) {
#ifndef PZ_EMULATED
    start_clock();
#else
    (void)start_clock;
#endif
    start_converters();
    if (piezo_params[AXIS].sampling_rate_Hz != (pz_real)RATE_Hz) {
        stop(); /* the bundle is for another rate */
    }
    const pz_real voltage_V = rise();
    if (pz_start(&state, &piezo_params[AXIS], voltage_V, read_sensor_m()) != PZ_OK) {
        stop(); /* parameters that pz_check refuses */
    }
    reference_m = state.reference_m;
    start_timer(); /* the interrupt begins after pz_start */
    watch();
    return 0;
}

void reset(void) {
    COPROCESSORS |= 0xFu << 20; /* the floating-point unit */
    __asm volatile("dsb\n isb" ::: "memory");
    for (uint32_t *to = data_begin, *from = data_stored; to < data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *word = bss_begin; word < bss_end;) {
        *word++ = 0;
    }
    (void)main();
#ifdef PZ_EMULATED
    extern void _exit(int);
    _exit(0);
#endif
    stop();
}
