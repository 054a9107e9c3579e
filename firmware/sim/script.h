// The script: which IMUs there are, what they feel, and what happens when.
#pragma once

#include <stdbool.h>

void script_load(const char *path);

// Return the instant of the next event [s], or infinity.
double script_next(void);

// Return what it is: one word.
const char *script_what(void);

// Do it; false where it is the end.
bool script_act(void);
