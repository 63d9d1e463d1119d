/* Hostile inputs, for the sanitisers: fuzz PARAMETERS STEPS SEED.
 *
 * PARAMETERS holds packed pz_parameters one after the other. Each set runs STEPS steps with
 * numbers of every kind; then bytes of it are overwritten at random, sealed again, and whatever
 * pz_check still accepts runs too. Exit status 0: every output was finite and inside its limits.
 */
#include <float.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "piezoid_runtime.h"

#ifdef PZ_REAL_FLOAT
#define LARGEST FLT_MAX
#define SMALLEST FLT_MIN
#else
#define LARGEST DBL_MAX
#define SMALLEST DBL_MIN
#endif

static uint64_t word;

static uint64_t draw(void) {
    word ^= word << 13;
    word ^= word >> 7;
    word ^= word << 17;
    return word;
}

static pz_real uniform(void) {
    return (pz_real)(draw() >> 40) / PZ_REAL(8388608.0) - PZ_REAL(1.0);
}

/* Mostly plausible, sometimes anything. */
static pz_real hostile(pz_real scale, pz_real last) {
    const pz_real zero = PZ_REAL(0.0);
    switch (draw() % 64) {
    case 0:
        return zero / (last - last);
    case 1:
        return LARGEST * PZ_REAL(2.0);
    case 2:
        return -LARGEST * PZ_REAL(2.0);
    case 3:
        return draw() % 2 ? LARGEST : -LARGEST;
    case 4:
        return SMALLEST / PZ_REAL(4.0);
    case 5:
        return -zero;
    case 6:
        return scale * PZ_REAL(1e6) * uniform();
    case 7: {
        pz_real any;
        const uint64_t bits = draw();
        memcpy(&any, &bits, sizeof any);
        return any;
    }
    case 8:
    case 9:
    case 10:
    case 11:
        return last;
    default:
        return scale * uniform();
    }
}

static uint64_t run(const pz_parameters *p, long steps) {
    const pz_real scale = p->method == PZ_METHOD_RST ? p->current_reference_A * PZ_REAL(4.0)
                                                     : PZ_REAL(3.0) * p->gain_m_per_V;
    pz_state state;
    pz_real reference = scale, measured = scale;
    uint64_t digest = 0;
    if (pz_start(&state, p, hostile(PZ_REAL(5.0), scale), hostile(scale, scale)) != PZ_OK) {
        abort();
    }
    for (long k = 0; k < steps; ++k) {
        reference = hostile(scale, reference);
        measured = hostile(scale, measured);
        if (draw() % 1024 == 0) {
            pz_schedule(&state, p, hostile(PZ_REAL(2.0), scale));
        }
        if (draw() % 512 == 0) {
            pz_reset(&state);
        }
        const pz_real volts = pz_step(&state, p, reference, measured);
        uint64_t bits = 0;
        memcpy(&bits, &volts, sizeof volts);
        digest = digest * 6364136223846793005u + bits;
        if (!(volts >= p->voltage_minimum_V && volts <= p->voltage_maximum_V)) {
            fprintf(stderr, "step %ld: %.17g V, status %u\n", k, (double)volts, state.status);
            exit(1);
        }
    }
    printf("method %d: status %u, digest %016llx\n", p->method, state.status_ever,
           (unsigned long long)digest);
    return digest;
}

static long mutate(const pz_parameters *original) {
    long accepted = 0;
    for (long trial = 0; trial < 4000; ++trial) {
        pz_parameters p = *original;
        for (uint64_t changes = 1 + draw() % 4; changes > 0; --changes) {
            ((unsigned char *)&p)[draw() % sizeof p] = (unsigned char)draw();
        }
        if (draw() % 2) {
            p.schema = PZ_SCHEMA_VERSION;
            p.size_bytes = (int32_t)sizeof p;
            p.checksum = pz_checksum(&p);
        }
        pz_state state;
        if (pz_start(&state, &p, PZ_REAL(0.0), PZ_REAL(0.0)) != PZ_OK) {
            (void)pz_step(&state, &p, PZ_REAL(0.0), PZ_REAL(0.0));
            continue;
        }
        ++accepted;
        for (long k = 0; k < 20; ++k) {
            const pz_real volts = pz_step(&state, &p, hostile(PZ_REAL(1.0), PZ_REAL(0.5)),
                                          hostile(PZ_REAL(1.0), PZ_REAL(0.5)));
            if (!(volts >= p.voltage_minimum_V && volts <= p.voltage_maximum_V)) {
                fprintf(stderr, "mutated: %.17g V\n", (double)volts);
                exit(1);
            }
        }
    }
    return accepted;
}

int main(int count, char **argument) {
    if (count != 4) {
        return 2;
    }
    FILE *file = fopen(argument[1], "rb");
    const long steps = atol(argument[2]);
    word = strtoull(argument[3], NULL, 10);
    pz_parameters p;
    long sets = 0;
    while (file != NULL && fread(&p, sizeof p, 1, file) == 1) {
        run(&p, steps);
        printf("mutated and accepted: %ld\n", mutate(&p));
        ++sets;
    }
    if (file != NULL) {
        fclose(file);
    }
    return sets > 0 ? 0 : 2;
}
