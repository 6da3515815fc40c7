/* For LD_PRELOAD: of all allocations of at least some bytes, one fails. glibc only. */
#include <errno.h>
#include <stdatomic.h>
#include <stddef.h>

void* __libc_malloc(size_t size);
void* __libc_calloc(size_t n, size_t size);
void* __libc_realloc(void* memory, size_t size);
void* __libc_memalign(size_t alignment, size_t size);

static atomic_long seen, wanted = -1; /* wanted: number of the one that fails; -1: none */
static size_t min_bytes = 0;
static atomic_int is_counting = 0;

/* Count allocations from now on; the n-th from now fails, none where n is negative. */
void fail_allocation(long n, size_t least) {
    min_bytes = least;
    seen = 0;
    wanted = n;
    is_counting = 1;
}

/* Stop; how many were seen. */
long stop_failing(void) {
    is_counting = 0;
    return seen;
}

static int fails(size_t size) {
    if (!is_counting || size < min_bytes || atomic_fetch_add(&seen, 1) != wanted) {
        return 0;
    }
    errno = ENOMEM;
    return 1;
}

void* malloc(size_t size) { return fails(size) ? NULL : __libc_malloc(size); }

void* calloc(size_t n, size_t size) { return fails(n * size) ? NULL : __libc_calloc(n, size); }

void* realloc(void* memory, size_t size) {
    return fails(size) ? NULL : __libc_realloc(memory, size);
}

void* memalign(size_t alignment, size_t size) {
    return fails(size) ? NULL : __libc_memalign(alignment, size);
}

void* aligned_alloc(size_t alignment, size_t size) { return memalign(alignment, size); }

int posix_memalign(void** memory, size_t alignment, size_t size) {
    void* found = memalign(alignment, size);
    if (found == NULL) {
        return ENOMEM;
    }
    *memory = found;
    return 0;
}
