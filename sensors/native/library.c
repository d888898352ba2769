/* The sensors' headers as a shared library, with a table of where their records' fields lie. */

#include "surefoot_random.h"

#include "library.h"

/* clang-format off */
static const place places[] = {
    WHOLE_OF(random), PLACE(random, key, "word"), PLACE(random, count, "word"),
};
/* clang-format on */

LIBRARY_OF(places)

EXPORTED void surefoot_philox(const uint32_t *counter, const uint32_t *key, uint32_t *word) {
    sf_philox(counter, key, word);
}

/* n numbers of each robot, or of those with a mark alone (the others draw, and forget that they did): the robots'
   axis comes after others of the robot's own, and the axes after it hold `rest` numbers. */
EXPORTED void surefoot_draw(sf_random *streams, const unsigned char *marks, size_t robots, size_t n, size_t rest,
                            int normal, double *out) {
    for (size_t robot = 0; robot < robots; robot++) {
        sf_random stream = streams[robot];
        double pair[2];
        for (size_t i = 0; i < n; i++) {
            if (i % 2 == 0 && normal)
                sf_random_normal_pair(&stream, pair);
            else if (i % 2 == 0)
                sf_random_pair(&stream, pair);
            out[(i / rest * robots + robot) * rest + i % rest] = pair[i % 2];
        }
        if (!marks || marks[robot]) streams[robot] = stream;
    }
}
