// What the board says and hears: packets from the IMUs' state, answers to requests.
#pragma once

#include <stdint.h>

void link_begin();

// Say whether the first HELLO has been sent.  Before it the host would not know that the clock and
// the numbers of the scans have begun anew, so nothing else is sent until then.
bool link_has_greeted();

// Answer what the host has asked.
void link_answer();

// Read all IMUs that are ready, and send what they say.
void link_scan();

// A scan that cannot be made any more: count it, so that its number is missing.
void link_skip_scan();

// Send what is due besides: who the board is, where that has changed; once a second how it fares.
// Return whether anything was.
bool link_tend();
