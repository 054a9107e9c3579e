"""From a device to blocks of bytes with the instant of their arrival."""
