/* Prints sizes and offsets of the structs of the interface. */
#include <stdio.h>

#include "downbeat.h"

int main(void) {
    printf("%zu %zu %zu %zu %zu %zu %zu %zu %zu %zu %zu %zu %zu\n", sizeof(downbeat_value_v1), offsetof(downbeat_value_v1, count),
           sizeof(downbeat_setting_v1), offsetof(downbeat_setting_v1, is_read_only), sizeof(downbeat_event_v1),
           offsetof(downbeat_event_v1, is_error), sizeof(downbeat_host_v1), offsetof(downbeat_host_v1, publish),
           offsetof(downbeat_host_v1, saved), sizeof(downbeat_module_v1), offsetof(downbeat_module_v1, restore),
           offsetof(downbeat_host_v1, variable), offsetof(downbeat_module_v1, variables));
    return 0;
}
