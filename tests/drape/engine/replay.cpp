// Makes recorded calls (tape.py) by a library and compares, bit by bit, what they return and write:
//
//     replay LIBRARY... TAPE
//
// Prints a line for every function that differs, and returns how many do.
#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct Scratch {
  uint8_t* begin;
  int64_t size, used;
  bool overflowed;
};
struct Numbers {
  int64_t size, bytes;  // of one number, negative for whole ones; of all
  uint8_t *now, *after;
};
typedef int64_t (*Any)(int64_t, int64_t, int64_t, int64_t, int64_t, int64_t, int64_t, int64_t, int64_t, int64_t, int64_t,
                       int64_t, int64_t, int64_t, int64_t, int64_t, double, double, double, double, double, double,
                       double, double);

static FILE* tape;
static int64_t whole() {
  int64_t number = 0;
  if (fread(&number, 8, 1, tape) != 1) exit(100);
  return number;
}
static uint8_t* bytes(int64_t count) {
  uint8_t* found = (uint8_t*)calloc(count + 64, 1);  // functions read a little farther than they use
  if (count && fread(found, count, 1, tape) != 1) exit(101);
  return found;
}

// The largest difference of numbers.
static double difference(const Numbers& a) {
  double most = 0;
  for (int64_t n = 0; a.size > 0 && n < a.bytes / a.size; ++n) {
    double own = a.size == 4 ? ((float*)a.now)[n] : ((double*)a.now)[n];
    double other = a.size == 4 ? ((float*)a.after)[n] : ((double*)a.after)[n];
    if (!(fabs(own - other) <= most)) most = fabs(own - other);
  }
  return most;
}

int main(int count, char** given) {
  int64_t calls = 0, wrong = 0;
  Scratch scratch = {(uint8_t*)malloc(256 << 20), 256 << 20, 0, false};
  tape = fopen(given[count - 1], "rb");
  if (!tape) return 102;
  char name[64];
  while (fread(name, 64, 1, tape) == 1) {
    Any function = nullptr;
    for (int n = 1; n < count - 1 && !function; ++n) function = (Any)dlsym(dlopen(given[n], RTLD_NOW), name);
    if (!function) return fprintf(stderr, "%s: missing\n", name), 103;
    const int64_t returned = whole(), takes_scratch = whole(), arrays = whole();
    Numbers* array = (Numbers*)calloc(arrays, sizeof(Numbers));
    for (int64_t n = 0; n < arrays; ++n) {
      array[n].size = whole(), array[n].bytes = whole();
      array[n].now = bytes(array[n].bytes), array[n].after = bytes(array[n].bytes);
    }
    for (int64_t n = whole(); n > 0; --n) {  // a pointer is written, and left out of what is compared
      const int64_t holder = whole(), at = whole(), target = whole();
      const uint64_t address = (uint64_t)array[target].now;
      memcpy(array[holder].now + at, &address, 8), memcpy(array[holder].after + at, &address, 8);
    }
    int64_t i[16] = {}, ints = 0, doubles = 0;
    double d[8] = {};
    for (int64_t n = whole(); n > 0; --n) {
      const int64_t kind = whole(), value = whole();
      if (kind == 1)
        memcpy(&d[doubles++], &value, 8);
      else
        i[ints++] = kind == 2 ? (int64_t)array[value].now : value;
    }
    scratch.used = 0;
    if (takes_scratch) i[ints++] = (int64_t)&scratch;
    // Whole numbers and doubles go in registers of their own, and whole ones beyond those on the stack, in order.
    const int64_t found = function(i[0], i[1], i[2], i[3], i[4], i[5], i[6], i[7], i[8], i[9], i[10], i[11], i[12],
                                   i[13], i[14], i[15], d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7]);
    double most = 0;
    bool same = found == returned && !scratch.overflowed;
    for (int64_t n = 0; n < arrays; ++n) {
      same &= memcmp(array[n].now, array[n].after, array[n].bytes) == 0;
      if (!(difference(array[n]) <= most)) most = difference(array[n]);
      free(array[n].now), free(array[n].after);
    }
    free(array);
    if (!same) printf("%s: returned %lld of %lld, numbers differ by %g\n", name, (long long)found, (long long)returned, most);
    wrong += !same, ++calls;
  }
  printf("%lld calls, %lld differ\n", (long long)calls, (long long)wrong);
  return wrong > 99 ? 99 : int(wrong);
}
