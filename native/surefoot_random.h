/* Random numbers that belong to a robot's device: Philox4x32-10 in C99.

   The specification is sensors/randomness.py. A stream is a key and a count of blocks; the block n is a function of
   both and of nothing else, and gives two numbers. A draw of n numbers takes (n + 1) / 2 blocks.

   Source: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011; tested against the
   vectors that its authors publish. */

#ifndef SUREFOOT_RANDOM_H
#define SUREFOOT_RANDOM_H

#ifndef SF_NO_LIBC /* see device.h */
#include <math.h>
#include <stdint.h>
#include <string.h>
#endif

#ifdef SF_SINGLE
typedef float sf_real;
#else
typedef double sf_real;
#endif
#ifndef SF_API
#define SF_API static inline
#endif

#define SF_DRAWN 32 /* numbers at a time */

typedef struct {
    uint64_t key, count;
} sf_random;

SF_API void sf_philox(const uint32_t counter[4], const uint32_t key[2], uint32_t word[4]) {
    uint32_t a = counter[0], b = counter[1], c = counter[2], d = counter[3], k = key[0], l = key[1];
    for (int turn = 0; turn < 10; turn++) {
        uint64_t first = (uint64_t)0xD2511F53u * a, second = (uint64_t)0xCD9E8D57u * c;
        a = (uint32_t)(second >> 32) ^ b ^ k;
        b = (uint32_t)second;
        c = (uint32_t)(first >> 32) ^ d ^ l;
        d = (uint32_t)first;
        k += 0x9E3779B9u;
        l += 0xBB67AE85u;
    }
    word[0] = a, word[1] = b, word[2] = c, word[3] = d;
}

SF_API double sf_from_words(uint32_t high, uint32_t low) {
    return ((double)(high >> 5) * 67108864.0 + (double)(low >> 6)) / 9007199254740992.0;
}

/* The next block: two numbers from [0, 1). */
SF_API void sf_random_pair(sf_random *stream, double pair[2]) {
    uint32_t counter[4] = {(uint32_t)stream->count, (uint32_t)(stream->count >> 32), 0, 0};
    uint32_t key[2] = {(uint32_t)stream->key, (uint32_t)(stream->key >> 32)}, word[4];
    sf_philox(counter, key, word);
    stream->count++;
    pair[0] = sf_from_words(word[0], word[1]);
    pair[1] = sf_from_words(word[2], word[3]);
}

/* The next n numbers, uniform ones or normal ones by Box and Muller; what is left of the last block is dropped. */
SF_API void sf_random_fill(sf_random *stream, int normal, int n, sf_real *out) {
    /* One kind of function after the other, of several blocks: none waits for the result of another. */
    double drawn[SF_DRAWN];
    for (int count; n > 0; n -= count, out += count) {
        count = n < SF_DRAWN ? n : SF_DRAWN;
        for (int i = 0; i < count; i += 2) sf_random_pair(stream, drawn + i);
#ifdef SF_SINGLE
        for (int i = 0; normal && i < count; i += 2) drawn[i] = sqrtf(-2 * logf((float)(1.0 - drawn[i])));
        for (int i = 0; normal && i < count; i += 2) {
            float radius = (float)drawn[i], angle = 6.2831853f * (float)drawn[i + 1];
            drawn[i] = radius * cosf(angle);
            drawn[i + 1] = radius * sinf(angle);
        }
#else
        for (int i = 0; normal && i < count; i += 2) drawn[i] = sqrt(-2.0 * log(1.0 - drawn[i]));
        for (int i = 0; normal && i < count; i += 2) {
            double radius = drawn[i], angle = 6.283185307179586 * drawn[i + 1];
            drawn[i] = radius * cos(angle);
            drawn[i + 1] = radius * sin(angle);
        }
#endif
        for (int i = 0; i < count; i++) out[i] = (sf_real)drawn[i];
    }
}

#endif
