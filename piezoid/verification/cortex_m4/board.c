/* The emulated board, machine mps2-an386: vectors, floating-point unit on, a counter, its stack.
 *
 * The core's timer runs at 25 MHz, 40 ns a tick; the emulator is told that an instruction takes
 * 32 ns (-icount shift=5), so 4 ticks are 5 instructions.
 */
#include <stdint.h>
#include <unistd.h>

extern char board_stack_top[], board_bss_begin[], board_bss_end[];
extern void initialise_monitor_handles(void);
extern int main(void);

void board_reset(void);
uint32_t board_instructions(void);
void board_paint_stack(void);
uint32_t board_painted_stack(void);

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define TIMER_CONTROL REGISTER(0xE000E010)
#define TIMER_RELOAD REGISTER(0xE000E014)
#define TIMER_VALUE REGISTER(0xE000E018)
#define COPROCESSORS REGISTER(0xE000ED88)

#define TIMER_MASK 0x00FFFFFFu
#define PAINT 0xA5A5A5A5u
#define PAINTED_WORDS 1024u
#define OWN_FRAME_WORDS 16u /* what painting itself needs below the caller */

static uint32_t ticks, last;

static void board_halt(void) {
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void))board_stack_top,
    board_reset,
    board_halt,
    board_halt,
};

void board_reset(void) {
    COPROCESSORS |= 0xFu << 20; /* full access to the floating-point unit */
    __asm volatile("dsb\n isb" ::: "memory");
    for (char *byte = board_bss_begin; byte < board_bss_end; ++byte) {
        *byte = 0;
    }
    TIMER_RELOAD = TIMER_MASK;
    TIMER_VALUE = 0;
    TIMER_CONTROL = 5; /* on, core clock, no interrupt */
    initialise_monitor_handles();
    _exit(main());
}

/* Instructions since the reset; call it at least every 16 million ticks. */
uint32_t board_instructions(void) {
    const uint32_t now = TIMER_VALUE & TIMER_MASK;
    ticks += (last - now) & TIMER_MASK;
    last = now;
    return ticks + ticks / 4;
}

/* The words below the caller's frame. */
__attribute__((noinline)) void board_paint_stack(void) {
    volatile uint32_t *const top = (uint32_t *)__builtin_frame_address(0) - OWN_FRAME_WORDS;
    for (uint32_t i = 1; i <= PAINTED_WORDS; ++i) {
        top[-(int32_t)i] = PAINT;
    }
}

/* Bytes below the caller's frame that no longer hold the paint. */
__attribute__((noinline)) uint32_t board_painted_stack(void) {
    const volatile uint32_t *const top = (uint32_t *)__builtin_frame_address(0) - OWN_FRAME_WORDS;
    uint32_t untouched = 0;
    while (untouched < PAINTED_WORDS &&
           top[(int32_t)untouched - (int32_t)PAINTED_WORDS] == PAINT) {
        ++untouched;
    }
    return (PAINTED_WORDS - untouched + OWN_FRAME_WORDS) * (uint32_t)sizeof(uint32_t);
}
