// What was done wrong, how often, and when first; at the end as JSON.
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "sim.h"

#define MOST 64

struct Count {
  char text[96];
  long times;
  double first;
};
struct Counts {
  struct Count of[MOST];
  int kinds;
};
static struct Counts violations, contentions;

static void count(struct Counts *counts, const char *format, va_list arguments) {
  char text[sizeof counts->of[0].text];
  vsnprintf(text, sizeof text, format, arguments);
  for (int k = 0; k < counts->kinds; k++) {
    if (strcmp(counts->of[k].text, text) == 0) {
      counts->of[k].times++;
      return;
    }
  }
  if (counts->kinds == MOST) return;
  struct Count *fresh = &counts->of[counts->kinds++];
  strcpy(fresh->text, text);
  fresh->times = 1;
  fresh->first = avr ? board_now() : 0;
}

void violated(const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  count(&violations, format, arguments);
  va_end(arguments);
}

void contended(const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  count(&contentions, format, arguments);
  va_end(arguments);
}

static void print(FILE *file, const char *name, const struct Counts *counts) {
  fprintf(file, "  \"%s\": [", name);
  for (int k = 0; k < counts->kinds; k++) {
    const struct Count *each = &counts->of[k];
    fprintf(file, "%s\n    {\"what\": \"%s\", \"times\": %ld, \"first_s\": %.6f}", k ? "," : "",
            each->text, each->times, each->first);
  }
  fprintf(file, "],\n");
}

void report(const char *path) {
  FILE *file = path ? fopen(path, "w") : stderr;
  if (!file) {
    fprintf(stderr, "Cannot write the report `%s`.\n", path);
    exit(2);
  }
  fprintf(file, "{\n");
  print(file, "violations", &violations);
  print(file, "contentions", &contentions);
  fprintf(file, "  \"seconds\": %.6f,\n  \"bytes\": %ld,\n  \"dropped_bytes\": %ld,\n",
          board_now(), totals.bytes, totals.dropped_bytes);
  fprintf(file, "  \"transactions\": %ld,\n  \"refused\": %ld,\n  \"resets\": %ld,\n",
          totals.transactions, totals.refused, totals.resets);
  fprintf(file, "  \"overrun_bytes\": %ld,\n  \"opened_ns\": %lld,\n  \"behind_s\": %.6f\n}\n",
          totals.overrun_bytes, totals.opened_ns, totals.behind);
  if (path) fclose(file);
}
