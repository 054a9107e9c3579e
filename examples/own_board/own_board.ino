// The wire format on a board of your own, in a page: one MPU-6050, read 200 times a second by
// anything with an Arduino core and a little-endian processor (ESP32, RP2040, Teensy, SAMD).
// docs/wire_format.md says what each field means; `ros2 run multiimu_ros driver` reads it.
#include <Wire.h>
#include <string.h>

const uint32_t PERIOD_US = 5000;
const uint8_t IMU = 0x68;
uint8_t packet[64], heard[16];
size_t size, heard_size;
uint16_t seq, failures;
uint32_t scan_at, status_at;

template <typename T>
void put(const T &value) {
  memcpy(packet + size, &value, sizeof value);
  size += sizeof value;
}

uint16_t crc_of(const uint8_t *bytes, size_t count) {
  uint16_t crc = 0xFFFF;
  for (size_t i = 0; i < count; i++) {
    crc ^= bytes[i] << 8;
    for (int bit = 0; bit < 8; bit++) crc = crc & 0x8000 ? crc << 1 ^ 0x1021 : crc << 1;
  }
  return crc;
}

// Close the packet with its two checks, stuff it, send it, and begin the next.
void send() {
  uint32_t a = 1, sum = 0;
  for (size_t i = 0; i < size; i++) sum = (sum + (a = (a + packet[i]) % 65521)) % 65521;
  put<uint16_t>(sum);
  put<uint16_t>(crc_of(packet, size));
  uint8_t frame[sizeof packet + 2];
  size_t code = 0, at = 1;
  for (size_t i = 0; i <= size; i++) {
    if (i < size && packet[i] != 0) {
      frame[at++] = packet[i];
    } else {
      frame[code] = at - code;
      code = at++;
    }
  }
  frame[code] = 0;  // behind the last byte: the end
  Serial.write(frame, at);
  size = 0;
}

void send_hello(uint8_t reason) {
  put<uint8_t>(0x01), put<uint8_t>(1), put(reason), put<uint8_t>(1), put<uint8_t>(0);
  put<uint16_t>(1000000 / PERIOD_US), put<uint32_t>(micros()), put<uint8_t>(1);
  put<uint8_t>(0), put<uint8_t>(0), put(IMU), put<uint8_t>(255);  // imu0, model unknown, no mux
  put<uint16_t>(2000), put<uint16_t>(8);
  put<float>(0.017453293f / 16.4f), put<float>(9.80665f / 4096);
  send();
}

void send_status() {
  put<uint8_t>(0x03), put<uint32_t>(micros()), put<uint16_t>(0), put<uint16_t>(0);
  put<uint16_t>(1), put(failures), put<int16_t>(-32768);
  send();
}

bool read_imu(int16_t *counts) {
  Wire.beginTransmission(IMU);
  Wire.write(0x3B);
  if (Wire.endTransmission(false) != 0 || Wire.requestFrom(IMU, (uint8_t)14) != 14) return false;
  int16_t words[7];  // force, temperature, rate; big-endian
  for (int16_t &word : words) word = Wire.read() << 8, word |= Wire.read();
  for (int i = 0; i < 3; i++) counts[i] = words[4 + i], counts[3 + i] = words[i];
  return true;
}

void send_scan() {
  const uint32_t begin = micros();
  int16_t counts[6];
  const bool answered = read_imu(counts);
  put<uint8_t>(0x02), put(seq++), put(begin), put<uint8_t>(answered);
  if (answered) put<uint16_t>(0), put(counts);
  failures += !answered;
  send();
}

// Unstuff a request in place; answer it if it is whole.  A board that does not hear works, too.
void answer(uint32_t arrived) {
  size_t zero_at = 0;
  for (size_t i = 0; i < heard_size; i++) {
    if (i == zero_at) zero_at += heard[i], heard[i] = 0;
  }
  const size_t end = heard_size - 2;  // where the CRC is
  if (zero_at != heard_size || heard_size < 6) return;
  if ((heard[end] | heard[end + 1] << 8) != crc_of(heard + 1, end - 1)) return;
  if (heard[1] == 0x11) send_hello(1);
  if (heard[1] != 0x12 || heard_size != 10) return;
  put<uint8_t>(0x04);
  for (int i = 2; i < 6; i++) put(heard[i]);  // the token
  put(arrived);
  send();
}

void hear() {
  while (Serial.available()) {
    const uint8_t byte = Serial.read();
    if (byte == 0) answer(micros());
    if (byte == 0) heard_size = 0;
    if (byte != 0 && heard_size < sizeof heard) heard[heard_size++] = byte;
  }
}

void write_register(uint8_t reg, uint8_t value) {
  Wire.beginTransmission(IMU);
  Wire.write(reg);
  Wire.write(value);
  Wire.endTransmission();
}

void setup() {
  Serial.begin(500000);
  Wire.begin();
  Wire.setClock(400000);
  write_register(0x6B, 0x01);  // awake, clock from the gyroscopes
  write_register(0x1A, 0x02);  // about 95 Hz wide
  write_register(0x1B, 0x18);  // 2000 deg/s
  write_register(0x1C, 0x10);  // 8 g
  send_hello(0);
  scan_at = status_at = micros();
}

void loop() {
  hear();
  if ((int32_t)(micros() - scan_at) >= 0) {
    scan_at += PERIOD_US;
    send_scan();
  } else if ((int32_t)(micros() - status_at) >= 0) {
    status_at += 1000000;
    send_status();
  }
}
