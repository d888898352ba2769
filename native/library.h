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

/* Rows of the table: a field of a record, under a name of its own; up to 16 fields of one kind; and as many fields of a
   part, of which the names begin with a prefix. */
#define PART(record, name, field, kind)                                                                      \
    {#record, #name, kind, offsetof(sf_##record, field), sizeof(((sf_##record *)0)->field)}
#define FIELDS(record, kind, ...) PARTS(record, , , kind, __VA_ARGS__)
#define PARTS(record, prefix, part, kind, ...)                                                               \
    SEVENTEENTH(__VA_ARGS__, EACH16, EACH15, EACH14, EACH13, EACH12, EACH11, EACH10, EACH9, EACH8, EACH7,    \
                EACH6, EACH5, EACH4, EACH3, EACH2, EACH1, )(record, prefix, part, kind, __VA_ARGS__)
#define SEVENTEENTH(a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p, q, ...) q
#define ROW(record, prefix, part, kind, field) PART(record, prefix##field, part field, kind)
#define EACH1(r, n, p, k, f) ROW(r, n, p, k, f)
#define EACH2(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH1(r, n, p, k, __VA_ARGS__)
#define EACH3(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH2(r, n, p, k, __VA_ARGS__)
#define EACH4(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH3(r, n, p, k, __VA_ARGS__)
#define EACH5(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH4(r, n, p, k, __VA_ARGS__)
#define EACH6(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH5(r, n, p, k, __VA_ARGS__)
#define EACH7(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH6(r, n, p, k, __VA_ARGS__)
#define EACH8(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH7(r, n, p, k, __VA_ARGS__)
#define EACH9(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH8(r, n, p, k, __VA_ARGS__)
#define EACH10(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH9(r, n, p, k, __VA_ARGS__)
#define EACH11(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH10(r, n, p, k, __VA_ARGS__)
#define EACH12(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH11(r, n, p, k, __VA_ARGS__)
#define EACH13(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH12(r, n, p, k, __VA_ARGS__)
#define EACH14(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH13(r, n, p, k, __VA_ARGS__)
#define EACH15(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH14(r, n, p, k, __VA_ARGS__)
#define EACH16(r, n, p, k, f, ...) ROW(r, n, p, k, f), EACH15(r, n, p, k, __VA_ARGS__)
#define WHOLE_OF(record) {#record, "", "", 0, sizeof(sf_##record)}

/* After the table. */
#define LIBRARY_OF(places)                                                                                   \
    EXPORTED const char *surefoot_source(void) { return SF_SOURCE; }                                         \
    EXPORTED const place *surefoot_places(void) { return places; }                                           \
    EXPORTED size_t surefoot_places_count(void) { return sizeof places / sizeof *places; }                   \
    EXPORTED size_t surefoot_real_size(void) { return sizeof(sf_real); }

#endif
