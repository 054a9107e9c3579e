"""From bytes to raw samples: framing, packets, the device's clock; no port is touched here."""
