/* What the linker of Windows demands of a Python module. All modules are opened by ctypes and hold
 * plain functions; importing one ends in an error of Python's. */
void *PyInit__kernels(void);
void *PyInit__runtime(void);
void *PyInit__runtime32(void);
void *PyInit__plant_loop(void);

void *PyInit__kernels(void) {
    return 0;
}

void *PyInit__runtime(void) {
    return 0;
}

void *PyInit__runtime32(void) {
    return 0;
}

void *PyInit__plant_loop(void) {
    return 0;
}
