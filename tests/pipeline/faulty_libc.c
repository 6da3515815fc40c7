/* Preloaded: faults that a test cannot ask of the machine without harm.
 *
 * CLOCK_JUMPS: the time of day goes a day back and forth with each look.
 */
#define _GNU_SOURCE
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t clock, struct timespec *now) {
    static long looks;
    const long failed = syscall(SYS_clock_gettime, clock, now);
    if (!failed && clock == CLOCK_REALTIME && getenv("CLOCK_JUMPS")) {
        now->tv_sec += (looks++ % 3 - 1) * 86400;
    }
    return (int)failed;
}
