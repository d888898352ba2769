/* For compilers without a C library, as those of kernels for GPUs (NVRTC, and Warp's clang): include it before
   surefoot's headers, as C++. What these compilers lack is here; the rest of math.h and string.h they know. */

#ifndef SUREFOOT_DEVICE_H
#define SUREFOOT_DEVICE_H

#define SF_NO_LIBC
#ifndef NULL
#define NULL 0
#endif
#ifdef __CUDACC__
#define SF_API static __device__ __noinline__ /* inlined into one kernel it takes NVRTC ten times as long */
#pragma nv_diag_suppress 177, 222 /* functions that a kernel does not call; infinity is meant */
#else
#define SF_API static inline
extern "C" double expm1(double), log1p(double);
SF_API double fmin(double a, double b) { return b < a || a != a ? b : a; }
SF_API double fmax(double a, double b) { return b > a || a != a ? b : a; }
#endif

/* A word at a time: all that is moved are numbers. */
typedef unsigned __attribute__((may_alias)) sf_word;
SF_API void *memmove(void *to, const void *from, size_t n) {
    sf_word *out = (sf_word *)to;
    const sf_word *in = (const sf_word *)from;
    if (out < in)
        for (size_t i = 0; i < n / sizeof *out; i++) out[i] = in[i];
    else
        for (size_t i = n / sizeof *out; i > 0; i--) out[i - 1] = in[i - 1];
    return to;
}

SF_API int memcmp(const void *one, const void *other, size_t n) {
    const unsigned char *a = (const unsigned char *)one, *b = (const unsigned char *)other;
    for (size_t i = 0; i < n; i++)
        if (a[i] != b[i]) return a[i] < b[i] ? -1 : 1;
    return 0;
}

#endif
