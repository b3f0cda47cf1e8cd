/* downbeat_cdr.h: reading and writing CDR in C11, for the structs that `downbeat interface generate --lang c` writes.
 *
 * Values are written in the byte order of the machine and read in both. A writer or reader that has failed ignores what
 * follows; `error` says why. Sequences and strings own their memory: `init` before use (or zero the struct), `fini` after.
 */
#ifndef DOWNBEAT_CDR_H
#define DOWNBEAT_CDR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Zero it before its first use; `downbeat_writer_fini` frees the bytes. */
typedef struct downbeat_writer {
    uint8_t *data;
    size_t size;
    size_t capacity;
    const char *error; /* NULL, or the reason and the field */
} downbeat_writer;

typedef struct downbeat_reader {
    const uint8_t *data; /* after the encapsulation header */
    size_t size;
    size_t position;
    bool is_swapped;
    const char *error;
} downbeat_reader;

static inline bool downbeat_is_little_endian(void) {
    const uint16_t one = 1;
    uint8_t first;
    memcpy(&first, &one, 1);
    return first == 1;
}

static inline void downbeat_write_fails(downbeat_writer *writer, const char *error) {
    if (!writer->error) {
        writer->error = error;
    }
}

static inline void downbeat_read_fails(downbeat_reader *reader, const char *error) {
    if (!reader->error) {
        reader->error = error;
    }
}

static inline void downbeat_put_bytes(downbeat_writer *writer, const void *bytes, size_t size) {
    if (writer->error || size == 0) {
        return;
    }
    if (writer->capacity - writer->size < size) {
        size_t capacity = writer->capacity * 2 + size + 64;
        uint8_t *data = (uint8_t *)realloc(writer->data, capacity);
        if (!data) {
            downbeat_write_fails(writer, "out of memory");
            return;
        }
        writer->data = data;
        writer->capacity = capacity;
    }
    memcpy(writer->data + writer->size, bytes, size);
    writer->size += size;
}

/* Starts a value; the memory of the value before is used again. */
static inline void downbeat_writer_start(downbeat_writer *writer) {
    const uint8_t header[4] = {0, downbeat_is_little_endian() ? 1 : 0, 0, 0};
    writer->size = 0;
    writer->error = NULL;
    downbeat_put_bytes(writer, header, sizeof header);
}

static inline void downbeat_writer_fini(downbeat_writer *writer) {
    free(writer->data);
    memset(writer, 0, sizeof *writer);
}

static inline void downbeat_put_aligned(downbeat_writer *writer, size_t alignment, const void *bytes, size_t size) {
    static const uint8_t zeros[8] = {0};
    if (size > 0) {
        downbeat_put_bytes(writer, zeros, (alignment - (writer->size - 4) % alignment) % alignment);
        downbeat_put_bytes(writer, bytes, size);
    }
}

/* Checks the header of a value and starts to read it. */
static inline void downbeat_reader_start(downbeat_reader *reader, const uint8_t *cdr, size_t size) {
    memset(reader, 0, sizeof *reader);
    if (size < 4 || cdr[0] != 0 || cdr[1] > 1) {
        reader->error = "the encapsulation header is not that of plain CDR";
        return;
    }
    reader->data = cdr + 4;
    reader->size = size - 4;
    reader->is_swapped = (cdr[1] == 1) != downbeat_is_little_endian();
}

static inline size_t downbeat_left(const downbeat_reader *reader) {
    return reader->size - reader->position;
}

/* Returns the next bytes, or NULL at the end. */
static inline const uint8_t *downbeat_get_aligned(downbeat_reader *reader, size_t alignment, size_t size) {
    if (reader->error) {
        return NULL;
    }
    size_t padding = (alignment - reader->position % alignment) % alignment;
    if (downbeat_left(reader) < padding || downbeat_left(reader) - padding < size) {
        reader->error = "the message ends before its last field";
        return NULL;
    }
    const uint8_t *bytes = reader->data + reader->position + padding;
    reader->position += padding + size;
    return bytes;
}

static inline void downbeat_copy_swapped(void *to, const uint8_t *from, size_t element, size_t count, bool is_swapped) {
    uint8_t *bytes = (uint8_t *)to;
    if (count == 0) {
        return;
    }
    if (!is_swapped || element == 1) {
        memcpy(bytes, from, element * count);
        return;
    }
    for (size_t index = 0; index < count; index++) {
        for (size_t byte = 0; byte < element; byte++) {
            bytes[index * element + byte] = from[index * element + element - 1 - byte];
        }
    }
}

/* Gives `*data` room for `count` elements; new ones are zero. */
static inline int downbeat_reserve(void **data, size_t *size, size_t *capacity, size_t element, size_t count) {
    if (count > *capacity) {
        void *larger = realloc(*data, element * count);
        if (!larger) {
            return -1;
        }
        *data = larger;
        *capacity = count;
    }
    if (count > *size) {
        memset((uint8_t *)*data + *size * element, 0, (count - *size) * element);
    }
    *size = count;
    return 0;
}

/* A sequence of numbers, and the functions for such fields. */
#define DOWNBEAT_PRIMITIVE(name, type)                                                                                         \
    typedef struct downbeat_##name##_sequence {                                                                                \
        type *data;                                                                                                            \
        size_t size;                                                                                                           \
        size_t capacity;                                                                                                       \
    } downbeat_##name##_sequence;                                                                                              \
    static inline int downbeat_##name##_sequence_resize(downbeat_##name##_sequence *sequence, size_t count) {                  \
        void *data = sequence->data;                                                                                           \
        int code = downbeat_reserve(&data, &sequence->size, &sequence->capacity, sizeof(type), count);                         \
        sequence->data = (type *)data;                                                                                         \
        return code;                                                                                                           \
    }                                                                                                                          \
    static inline void downbeat_##name##_sequence_fini(downbeat_##name##_sequence *sequence) {                                 \
        free(sequence->data);                                                                                                  \
        memset(sequence, 0, sizeof *sequence);                                                                                 \
    }                                                                                                                          \
    static inline void downbeat_put_##name##_array(downbeat_writer *writer, const type *values, size_t count) {                \
        downbeat_put_aligned(writer, sizeof(type), values, sizeof(type) * count);                                              \
    }                                                                                                                          \
    static inline void downbeat_put_##name(downbeat_writer *writer, type value) {                                              \
        downbeat_put_##name##_array(writer, &value, 1);                                                                        \
    }                                                                                                                          \
    static inline void downbeat_get_##name##_array(downbeat_reader *reader, type *values, size_t count) {                      \
        const uint8_t *bytes = count ? downbeat_get_aligned(reader, sizeof(type), sizeof(type) * count) : NULL;                \
        if (bytes) {                                                                                                           \
            downbeat_copy_swapped(values, bytes, sizeof(type), count, reader->is_swapped);                                     \
        }                                                                                                                      \
    }                                                                                                                          \
    static inline void downbeat_get_##name(downbeat_reader *reader, type *value) {                                             \
        downbeat_get_##name##_array(reader, value, 1);                                                                         \
    }

DOWNBEAT_PRIMITIVE(uint8, uint8_t)
DOWNBEAT_PRIMITIVE(int8, int8_t)
DOWNBEAT_PRIMITIVE(uint16, uint16_t)
DOWNBEAT_PRIMITIVE(int16, int16_t)
DOWNBEAT_PRIMITIVE(uint32, uint32_t)
DOWNBEAT_PRIMITIVE(int32, int32_t)
DOWNBEAT_PRIMITIVE(uint64, uint64_t)
DOWNBEAT_PRIMITIVE(int64, int64_t)
DOWNBEAT_PRIMITIVE(float32, float)
DOWNBEAT_PRIMITIVE(float64, double)

typedef struct downbeat_bool_sequence {
    bool *data;
    size_t size;
    size_t capacity;
} downbeat_bool_sequence;

static inline int downbeat_bool_sequence_resize(downbeat_bool_sequence *sequence, size_t count) {
    void *data = sequence->data;
    int code = downbeat_reserve(&data, &sequence->size, &sequence->capacity, sizeof(bool), count);
    sequence->data = (bool *)data;
    return code;
}

static inline void downbeat_bool_sequence_fini(downbeat_bool_sequence *sequence) {
    free(sequence->data);
    memset(sequence, 0, sizeof *sequence);
}

static inline void downbeat_put_bool(downbeat_writer *writer, bool value) {
    downbeat_put_uint8(writer, value ? 1 : 0);
}

static inline void downbeat_put_bool_array(downbeat_writer *writer, const bool *values, size_t count) {
    for (size_t index = 0; index < count; index++) {
        downbeat_put_bool(writer, values[index]);
    }
}

static inline void downbeat_get_bool(downbeat_reader *reader, bool *value) {
    uint8_t byte = 0;
    downbeat_get_uint8(reader, &byte);
    if (byte > 1) {
        downbeat_read_fails(reader, "a bool is neither 0 nor 1");
    }
    *value = byte == 1;
}

static inline void downbeat_get_bool_array(downbeat_reader *reader, bool *values, size_t count) {
    for (size_t index = 0; index < count; index++) {
        downbeat_get_bool(reader, &values[index]);
    }
}

/* UTF-8. `data` has a terminating zero after `size` bytes, or is NULL if empty. */
typedef struct downbeat_string {
    char *data;
    size_t size;
    size_t capacity;
} downbeat_string;

/* UTF-16 code units. */
typedef struct downbeat_wstring {
    uint16_t *data;
    size_t size;
    size_t capacity;
} downbeat_wstring;

static inline int downbeat_string_assign_bytes(downbeat_string *string, const char *bytes, size_t size) {
    if (string->capacity <= size) {
        char *data = (char *)realloc(string->data, size + 1);
        if (!data) {
            return -1;
        }
        string->data = data;
        string->capacity = size + 1;
    }
    if (size > 0) {
        memmove(string->data, bytes, size);
    }
    string->data[size] = 0;
    string->size = size;
    return 0;
}

static inline int downbeat_string_assign(downbeat_string *string, const char *text) {
    return downbeat_string_assign_bytes(string, text, strlen(text));
}

static inline void downbeat_string_fini(downbeat_string *string) {
    free(string->data);
    memset(string, 0, sizeof *string);
}

static inline int downbeat_wstring_assign(downbeat_wstring *string, const uint16_t *units, size_t size) {
    void *data = string->data;
    int code = downbeat_reserve(&data, &string->size, &string->capacity, sizeof(uint16_t), size);
    string->data = (uint16_t *)data;
    if (code == 0 && size > 0) {
        memmove(string->data, units, size * sizeof(uint16_t));
    }
    return code;
}

static inline void downbeat_wstring_fini(downbeat_wstring *string) {
    free(string->data);
    memset(string, 0, sizeof *string);
}

/* A sequence of strings. */
#define DOWNBEAT_STRING_SEQUENCE(name)                                                                                         \
    typedef struct downbeat_##name##_sequence {                                                                                \
        downbeat_##name *data;                                                                                                 \
        size_t size;                                                                                                           \
        size_t capacity;                                                                                                       \
    } downbeat_##name##_sequence;                                                                                              \
    static inline int downbeat_##name##_sequence_resize(downbeat_##name##_sequence *sequence, size_t count) {                  \
        void *data = sequence->data;                                                                                           \
        for (size_t index = count; index < sequence->size; index++) {                                                          \
            downbeat_##name##_fini(&sequence->data[index]);                                                                    \
        }                                                                                                                      \
        int code = downbeat_reserve(&data, &sequence->size, &sequence->capacity, sizeof(downbeat_##name), count);              \
        sequence->data = (downbeat_##name *)data;                                                                              \
        return code;                                                                                                           \
    }                                                                                                                          \
    static inline void downbeat_##name##_sequence_fini(downbeat_##name##_sequence *sequence) {                                 \
        (void)downbeat_##name##_sequence_resize(sequence, 0);                                                                  \
        free(sequence->data);                                                                                                  \
        memset(sequence, 0, sizeof *sequence);                                                                                 \
    }

DOWNBEAT_STRING_SEQUENCE(string)
DOWNBEAT_STRING_SEQUENCE(wstring)

static inline void downbeat_put_string(downbeat_writer *writer, const downbeat_string *string) {
    static const char zero = 0;
    downbeat_put_uint32(writer, (uint32_t)string->size + 1);
    downbeat_put_bytes(writer, string->data, string->size);
    downbeat_put_bytes(writer, &zero, 1);
}

static inline void downbeat_get_string(downbeat_reader *reader, downbeat_string *string) {
    uint32_t size = 0;
    downbeat_get_uint32(reader, &size);
    const uint8_t *bytes = downbeat_get_aligned(reader, 1, size);
    if (!bytes) {
        return;
    }
    /* Some senders leave out the terminating zero of an empty string. */
    size_t length = size > 0 && bytes[size - 1] == 0 ? size - 1 : size;
    if (downbeat_string_assign_bytes(string, (const char *)bytes, length) != 0) {
        downbeat_read_fails(reader, "out of memory");
    }
}

static inline void downbeat_put_wstring(downbeat_writer *writer, const downbeat_wstring *string) {
    downbeat_put_uint32(writer, (uint32_t)string->size);
    for (size_t index = 0; index < string->size; index++) {
        downbeat_put_uint32(writer, string->data[index]);
    }
}

static inline void downbeat_get_wstring(downbeat_reader *reader, downbeat_wstring *string) {
    uint32_t size = 0;
    downbeat_get_uint32(reader, &size);
    if (reader->error || size > downbeat_left(reader) / 4) {
        downbeat_read_fails(reader, "a string is longer than the message");
        return;
    }
    if (downbeat_wstring_assign(string, string->data, 0) != 0) {
        downbeat_read_fails(reader, "out of memory");
    }
    void *data = string->data;
    if (downbeat_reserve(&data, &string->size, &string->capacity, sizeof(uint16_t), size) != 0) {
        downbeat_read_fails(reader, "out of memory");
        return;
    }
    string->data = (uint16_t *)data;
    for (size_t index = 0; index < size; index++) {
        uint32_t unit = 0;
        downbeat_get_uint32(reader, &unit);
        string->data[index] = (uint16_t)unit;
    }
}

/* Reads the number of elements of a sequence, each of which has at least one byte. */
static inline size_t downbeat_get_count(downbeat_reader *reader) {
    uint32_t count = 0;
    downbeat_get_uint32(reader, &count);
    if (!reader->error && count > downbeat_left(reader)) {
        downbeat_read_fails(reader, "a sequence is longer than the message");
    }
    return reader->error ? 0 : count;
}

#ifdef __cplusplus
}
#endif
#endif
