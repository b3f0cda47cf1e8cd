// For LD_PRELOAD: keeps the bags in folders that a test removes. Their files are linked into $KEPT_BAGS first,
// in a folder of the test, by the path that they had.

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int is_of_a_bag(const char *name) {
    static const char *const suffixes[] = {".mcap", ".mcap.zstd", ".db3", ".db3.zstd", "metadata.yaml"};
    size_t length = strlen(name);
    for (size_t i = 0; i < sizeof suffixes / sizeof *suffixes; i++) {
        size_t suffix = strlen(suffixes[i]);
        if (length >= suffix && strcmp(name + length - suffix, suffixes[i]) == 0) return 1;
    }
    return 0;
}

static void keep(int folder, const char *name) {
    const char *kept = getenv("KEPT_BAGS"), *program = getenv("NEXTEST_BINARY_ID"), *test = getenv("NEXTEST_TEST_NAME");
    char opened[64], path[PATH_MAX], to[PATH_MAX];
    if (!kept || !program || !test || strchr(name, '/')) return;
    snprintf(opened, sizeof opened, "/proc/self/fd/%d", folder);
    ssize_t length = readlink(opened, path, sizeof path - 1);
    if (length < 0) return;
    path[length] = '\0';
    for (char *at = path; *at; at++) {
        if (*at == '/') *at = '!';
    }
    if (snprintf(to, sizeof to, "%s/%s::%s", kept, program, test) >= (int)sizeof to) return;
    mkdir(to, 0777);
    if (snprintf(to, sizeof to, "%s/%s::%s/%s", kept, program, test, path) >= (int)sizeof to) return;
    mkdir(to, 0777);
    if (snprintf(to, sizeof to, "%s/%s::%s/%s/%s", kept, program, test, path, name) >= (int)sizeof to) return;
    linkat(folder, name, AT_FDCWD, to, 0);
}

int unlinkat(int folder, const char *name, int flags) {
    static int (*next)(int, const char *, int);
    int before = errno;
    if (!next) next = (int (*)(int, const char *, int))dlsym(RTLD_NEXT, "unlinkat");
    if (!(flags & AT_REMOVEDIR) && folder != AT_FDCWD && is_of_a_bag(name)) keep(folder, name);
    errno = before;
    return next(folder, name, flags);
}
