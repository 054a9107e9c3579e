// What a user may want to change.  All of it can be given to the compiler: -DSCAN_RATE_HZ=200.
#pragma once

// Readings of all IMUs a second [Hz]; docs/firmware.md says how many are possible.
#ifndef SCAN_RATE_HZ
#define SCAN_RATE_HZ 100
#endif

// Full scale of those IMUs that can choose: 250, 500, 1000, 2000 [deg/s]; 2, 4, 8, 16 [g].
#ifndef ANGULAR_RATE_RANGE_DPS
#define ANGULAR_RATE_RANGE_DPS 2000
#endif
#ifndef FORCE_RANGE_G
#define FORCE_RANGE_G 8
#endif

// 0: the Wire library; 1: a polled driver of our own, which reads about 1.6 times as fast.
#ifndef BUS_POLLED
#define BUS_POLLED 0
#endif

// Clock of the I2C bus [Hz]; 100000 for long cables.
#ifndef BUS_CLOCK_HZ
#define BUS_CLOCK_HZ 400000
#endif

// Symbols a second.  500 000 is exact at 16 MHz; 115 200 would be 2.1 % off.
#ifndef BAUD
#define BAUD 500000
#endif

// The multiplexer: its address (0x70-0x77), and the pin at its RESET, or -1 if that is not wired.
#ifndef MUX_ADDRESS
#define MUX_ADDRESS 0x70
#endif
#ifndef MUX_RESET_PIN
#define MUX_RESET_PIN 4
#endif

// Where the IMUs are, in the order imu0, imu1 ...: at most eight times {channel, address}.
// Channel NO_MUX is the bus itself; address ANY takes whatever answers on that channel.  Two on
// one channel must be given their addresses: {0, 0x68}, {0, 0x69}.
#define NO_MUX 255
#define ANY 0
#ifndef IMU_PLACES
#define IMU_PLACES {0, ANY}, {1, ANY}, {2, ANY}, {3, ANY}, {4, ANY}, {5, ANY}, {6, ANY}, {7, ANY}
#endif
