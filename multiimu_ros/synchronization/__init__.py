"""Several streams to one time base."""
