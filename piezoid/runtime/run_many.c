/* For Python only, not shipped: whole arrays through the shipped pz_step, and its layout. */
#include "piezoid_runtime.h"

size_t pz_size_of_state(void);
size_t pz_size_of_real(void);
void pz_run_many(pz_state *state, const pz_parameters *parameters, size_t samples,
                 const pz_real *reference, const pz_real *measured, pz_real *voltage_V,
                 uint32_t *status);

size_t pz_size_of_state(void) {
    return sizeof(pz_state);
}

size_t pz_size_of_real(void) {
    return sizeof(pz_real);
}

/* The measurement does not depend on the output here: open loop, or a recorded sensor. */
void pz_run_many(pz_state *state, const pz_parameters *parameters, size_t samples,
                 const pz_real *reference, const pz_real *measured, pz_real *voltage_V,
                 uint32_t *status) {
    for (size_t k = 0; k < samples; ++k) {
        voltage_V[k] = pz_step(state, parameters, reference[k], measured[k]);
        status[k] = state->status;
    }
}
