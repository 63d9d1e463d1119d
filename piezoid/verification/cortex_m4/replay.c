/* Steps every axis through inputs.bin and writes every answer to answers.bin, bit for bit.
 *
 * The same file runs on the desk and on the emulated core. inputs.bin holds two 32-bit counts:
 * samples of each axis, and how many of them (the first ones) are an ordinary day's; then, axis by
 * axis, pairs of pz_real: reference, measured. answers.bin holds pz_real and the status word of
 * every sample. The last line printed for each axis: index, instructions of all ordinary samples,
 * most instructions of any sample, bytes of stack, bytes of state.
 */
#include <stdio.h>

#include "piezo_params.h"
#include "piezoid_runtime.h"

#ifdef PZ_BOARD
uint32_t board_instructions(void);
void board_paint_stack(void);
uint32_t board_painted_stack(void);
#else
static uint32_t board_instructions(void) {
    return 0;
}
static void board_paint_stack(void) {
}
static uint32_t board_painted_stack(void) {
    return 0;
}
#endif

#define PAINTED_SAMPLES 50

static pz_state state[PIEZO_AXES];

static int step_all(int axis, const uint32_t count[2], FILE *in, FILE *out) {
    uint32_t instructions = 0, most = 0, deepest = 0;
    for (uint32_t k = 0; k < count[0]; ++k) {
        pz_real pair[2];
        if (fread(pair, sizeof pair, 1, in) != 1) {
            return 1;
        }
        if (k == 0 && pz_start(&state[axis], &piezo_params[axis], PZ_REAL(0), pair[1]) != PZ_OK) {
            return 1;
        }
        if (k < PAINTED_SAMPLES) {
            board_paint_stack();
        }
        const uint32_t before = board_instructions();
        const pz_real voltage_V = pz_step(&state[axis], &piezo_params[axis], pair[0], pair[1]);
        const uint32_t after = board_instructions();
        const uint32_t counting = board_instructions() - after;
        if (k < PAINTED_SAMPLES) {
            const uint32_t used = board_painted_stack();
            deepest = used > deepest ? used : deepest;
        }
        const uint32_t taken = after - before - counting;
        most = taken > most ? taken : most;
        instructions += k < count[1] ? taken : 0;
        if (fwrite(&voltage_V, sizeof voltage_V, 1, out) != 1 ||
            fwrite(&state[axis].status, sizeof(uint32_t), 1, out) != 1) {
            return 1;
        }
    }
    printf("%d %lu %lu %lu %lu\n", axis, (unsigned long)instructions, (unsigned long)most,
           (unsigned long)deepest, (unsigned long)sizeof(pz_state));
    return 0;
}

int main(void) {
    uint32_t count[2];
    FILE *const in = fopen("inputs.bin", "rb");
    FILE *const out = fopen("answers.bin", "wb");
    if (in == NULL || out == NULL || fread(count, sizeof count, 1, in) != 1) {
        return 1;
    }
    for (int axis = 0; axis < PIEZO_AXES; ++axis) {
        if (step_all(axis, count, in, out) != 0) {
            return 1;
        }
    }
    return fclose(out) == 0 && fflush(stdout) == 0 ? 0 : 1;
}
