// What the sensors feel: counters that tell every sample apart, a formula, or a table from a file.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "device.h"

static enum { COUNTER, FORMULA, TABLE } kind;

struct Table {
  double (*rows)[7];  // time [s], angular rate [rad/s], specific force [m/s^2]
  long count;
};
static struct Table tables[MAX_IMUS];

static void load(struct Table *table, const char *path) {
  FILE *file = fopen(path, "r");
  if (!file) return;
  long room = 0;
  double row[7];
  while (fscanf(file, "%lf,%lf,%lf,%lf,%lf,%lf,%lf", row, row + 1, row + 2, row + 3, row + 4,
                row + 5, row + 6) == 7) {
    if (table->count == room) {
      room = room ? 2 * room : 4096;
      table->rows = realloc(table->rows, room * sizeof row);
    }
    memcpy(table->rows[table->count++], row, sizeof row);
  }
  fclose(file);
}

// `path` has one %d, for the number of the IMU.
void motion_choose(const char *name, const char *path) {
  if (strcmp(name, "counter") == 0) {
    kind = COUNTER;
  } else if (strcmp(name, "formula") == 0) {
    kind = FORMULA;
  } else if (strcmp(name, "csv") == 0) {
    kind = TABLE;
    long rows = 0;
    for (int k = 0; k < MAX_IMUS; k++) {
      char name_k[512];
      snprintf(name_k, sizeof name_k, path, k);
      load(&tables[k], name_k);
      rows += tables[k].count;
    }
    if (rows == 0) {
      fprintf(stderr, "No table could be read from `%s`.\n", path);
      exit(2);
    }
  } else {
    fprintf(stderr, "No motion is called `%s`.\n", name);
    exit(2);
  }
}

// Sample n of axis a of IMU k is n (2a + 3) + 4001 k + 611 a, modulo 2^16: no two samples of a
// minute are alike, and parts of two samples do not make a third.
bool motion_counts(int imu, long n, int16_t counts[6]) {
  if (kind != COUNTER) return false;
  for (int a = 0; a < 6; a++) counts[a] = (int16_t)(n * (2 * a + 3) + 4001 * imu + 611 * a);
  return true;
}

// Noise, the same in each run: a number from -1 to 1 out of its arguments.
static double noise(int imu, long n, int axis) {
  uint32_t x = (uint32_t)n * 2654435761u + (uint32_t)(8 * imu + axis) * 40503u;
  x ^= x >> 16, x *= 0x7feb352du, x ^= x >> 15, x *= 0x846ca68bu, x ^= x >> 16;
  return x / 2147483648.0 - 1;
}

static const double *row_at(const struct Table *table, double t) {
  long low = 0, high = table->count - 1;
  while (low < high) {
    const long middle = (low + high + 1) / 2;
    if (table->rows[middle][0] <= t + 1e-9) {
      low = middle;
    } else {
      high = middle - 1;
    }
  }
  return table->rows[low];
}

// The formula: a swing about z, level, with noise of about ten counts.
void motion_at(int imu, long n, double t, double values[6]) {
  if (kind == TABLE) {
    if (tables[imu].count > 0) memcpy(values, row_at(&tables[imu], t) + 1, 6 * sizeof *values);
    return;
  }
  const double swing = sin(2 * M_PI * t);
  for (int a = 0; a < 6; a++) values[a] = noise(imu, n, a) * (a < 3 ? 0.01 : 0.03);
  values[2] += swing;
  values[5] += GRAVITY;
}
