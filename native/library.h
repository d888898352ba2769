/* What every library of this package has: a table of where its records' fields lie, so that Python reads it and
   keeps no second copy. The source of a library includes its headers first, and then this. */

#ifndef SUREFOOT_LIBRARY_H
#define SUREFOOT_LIBRARY_H

#ifndef SF_NO_LIBC /* see device.h: only the table is of use there */
#include <stddef.h>
#endif

#ifdef SF_NO_LIBC
#define EXPORTED static
#define offsetof __builtin_offsetof
#elif defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif
#ifndef SF_SOURCE
#define SF_SOURCE ""
#endif

typedef struct {
    const char *record, *field, *kind; /* "real", "double", "int", "whole", "word" or "byte" */
    size_t offset, size;
} place;

#define PLACE(record, field, kind)                                                                           \
    {#record, #field, kind, offsetof(sf_##record, field), sizeof(((sf_##record *)0)->field)}
#define WHOLE_OF(record) {#record, "", "", 0, sizeof(sf_##record)}

/* After the table. */
#define LIBRARY_OF(places)                                                                                   \
    EXPORTED const char *surefoot_source(void) { return SF_SOURCE; }                                         \
    EXPORTED const place *surefoot_places(void) { return places; }                                           \
    EXPORTED size_t surefoot_places_count(void) { return sizeof places / sizeof *places; }                   \
    EXPORTED size_t surefoot_real_size(void) { return sizeof(sf_real); }

#endif
