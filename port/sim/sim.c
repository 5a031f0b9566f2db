/* The port contract on the host: every row of a CSV file is a tick, every tick a row of another; a pair for each axis. */
#define _XOPEN_SOURCE 700 /* POSIX.1-2008 and realpath */

#include <errno.h>
#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <time.h>
#include <unistd.h>

#include "rdpi_port.h"
#include "sim.h"

#define BLANKS " \t\r\n"
#define EXIT_BAD_INPUT 2

typedef struct {
    double time_s, reference_um;
    unsigned long line;
} row_t;

typedef struct {
    const char *name;
    row_t *rows;
    size_t count, capacity, next; /* next: the row that is due, or beyond the last */
    bool timed, taken;            /* taken: row `next` has become the reference */
} input_t;

typedef struct {
    const char *name; /* NULL: not wanted */
    FILE *file;
    char *target, *part; /* where the file goes when it is complete, and until then; NULL for pipes and devices */
} output_t;

/* Where an output goes: several names may lead to one place. */
typedef struct {
    const char *name, *what;
    const char *base; /* NULL: the file is there; otherwise its name in the folder */
    struct stat at;   /* of the file, or of the folder */
    bool found;       /* `at` is known */
} place_t;

/* The converter and all behind it. */
typedef struct {
    uint32_t code;
    float last_code; /* 0: volts not asked for */
    float min_V, V_per_code;
} dac_t;

static struct {
    input_t in;
    output_t out;
    dac_t dac;
} axes[RDPI_AXES];

static output_t telemetry;

static uint32_t rate_Hz;
static rdpi_port_tick_t on_tick;

int rdpi_port_sim_application(void); /* the application's main, see CMakeLists.txt */

static void discard(const output_t *output)
{
    if (output->file != NULL && output->part != NULL) {
        unlink(output->part);
    }
}

static void fail(const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        discard(&axes[k].out);
    }
    discard(&telemetry);
    exit(EXIT_BAD_INPUT);
}

/* A decimal number that a float can hold, and nothing else. By way of double, as in the host tools: the last bit must
 * not depend on who reads the file. */
static bool parse_number(const char *text, double *value)
{
    char *end;
    *value = strtod(text, &end);
    return end != text && *end == '\0' && fabs(*value) <= (double)FLT_MAX && strpbrk(text, "xX") == NULL;
}

/* Cuts the next field off the line, without blanks around it; NULL at the line's end. */
static char *next_field(char **line)
{
    char *field = *line;
    if (field == NULL) {
        return NULL;
    }
    char *comma = strchr(field, ',');
    *line = comma == NULL ? NULL : comma + 1;
    char *end = comma == NULL ? field + strlen(field) : comma;
    field += strspn(field, BLANKS);
    while (end > field && strchr(BLANKS, end[-1]) != NULL) {
        end--;
    }
    *end = '\0';
    return field;
}

/* Places of the columns in the line of names, -1 where there is none; returns how many columns there are. */
static int read_names(const input_t *in, char *line, unsigned long number, int *time, int *reference)
{
    int count = 0;
    *time = *reference = -1;
    for (char *field = next_field(&line); field != NULL; field = next_field(&line), count++) {
        if (strcmp(field, "time_s") == 0) {
            *time = count;
        } else if (strcmp(field, "reference_um") == 0) {
            *reference = count;
        }
    }
    if (*reference < 0) {
        fail("%s:%lu: no column reference_um; name the columns in this line, the reference so", in->name, number);
    }
    return count;
}

static void read_row(input_t *in, char *line, unsigned long number, int columns, int time, int reference)
{
    row_t row = {0, 0, number};
    int count = 0;
    for (char *field = next_field(&line); field != NULL; field = next_field(&line), count++) {
        double value;
        if (count != time && count != reference) {
            continue;
        }
        if (!parse_number(field, &value)) {
            fail("%s:%lu: %s is '%.40s', not a number; correct it or take the line out", in->name, number,
                 count == time ? "time_s" : "reference_um", field);
        }
        if (count == time) {
            row.time_s = value;
        } else {
            row.reference_um = value;
        }
    }
    if (count != columns) {
        fail("%s:%lu: %d values where there should be %d; complete the line or take it out", in->name, number, count,
             columns);
    }
    if (in->count == in->capacity) {
        in->capacity = 2 * in->capacity + 1024;
        in->rows = realloc(in->rows, in->capacity * sizeof *in->rows);
        if (in->rows == NULL) {
            fail("%s:%lu: no memory for so many samples; cut the reference", in->name, number);
        }
    }
    in->rows[in->count++] = row;
}

/* Everything is read and checked before the application starts, so that bad input leaves no output behind. */
static void read_reference(input_t *in, FILE *file)
{
    char *line = NULL;
    size_t size = 0;
    int columns = 0, time = -1, reference = -1;
    ssize_t length;
    for (unsigned long number = 1; (length = getline(&line, &size, file)) >= 0; number++) {
        if (strlen(line) != (size_t)length) {
            fail("%s:%lu: a NUL byte; is this a text file, and written to its end?", in->name, number);
        }
        char *text = number == 1 && strncmp(line, "\xef\xbb\xbf", 3) == 0 ? line + 3 : line; /* byte-order mark */
        text += strspn(text, BLANKS);
        if (*text == '\0' || (columns == 0 && *text == '#')) {
            continue;
        }
        if (columns == 0) {
            columns = read_names(in, text, number, &time, &reference);
        } else {
            read_row(in, text, number, columns, time, reference);
        }
    }
    free(line);
    if (ferror(file)) {
        fail("%s: cannot be read; check the file", in->name);
    }
    if (in->count == 0) {
        fail("%s: no samples; a reference has a line time_s,reference_um and then one line per sample", in->name);
    }
    in->timed = time >= 0;
}

/* A regular file is written beside its place and moved there when complete: nobody meets half a drive. */
static void open_output(output_t *output)
{
    struct stat old;
    bool exists = stat(output->name, &old) == 0;
    if (strcmp(output->name, "-") == 0) {
        output->file = stdout;
    } else if (exists && !S_ISREG(old.st_mode)) {
        output->file = fopen(output->name, "w");
    } else if (exists || errno == ENOENT) {
        output->target = exists ? realpath(output->name, NULL) : strdup(output->name); /* a link stays one */
        output->part = output->target == NULL ? NULL : malloc(strlen(output->target) + sizeof ".part");
        if (output->part != NULL) {
            strcat(strcpy(output->part, output->target), ".part");
            output->file = fopen(output->part, "w");
        }
        if (output->file != NULL && exists) {
            fchmod(fileno(output->file), old.st_mode & 07777);
        }
    }
    if (output->file == NULL) {
        fail("%s: cannot be written; check the path and permissions", output->name);
    }
}

static void close_output(output_t *output)
{
    if (output->file == NULL) {
        return;
    }
    bool complete = !ferror(output->file);
    complete = fclose(output->file) == 0 && complete;
    if (!complete || (output->part != NULL && rename(output->part, output->target) != 0)) {
        fail("%s: cannot be written to its end; is the disk full?", output->name);
    }
}

/* The times of a reference are those of the application's ticks. */
static void check_times(const input_t *in, uint32_t rate_hz)
{
    for (size_t k = 0; in->timed && k < in->count; k++) {
        double due_s = in->rows[0].time_s + (double)k / rate_hz;
        if (fabs(in->rows[k].time_s - due_s) > 0.25 / rate_hz) {
            fail("%s:%lu: time_s is %.9g where %.9g is due: the application runs at %lu samples per second; resample "
                 "the reference, or build the application for its rate",
                 in->name, in->rows[k].line, in->rows[k].time_s, due_s, (unsigned long)rate_hz);
        }
    }
}

bool rdpi_port_start(uint32_t rate_hz, rdpi_port_tick_t tick)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        check_times(&axes[k].in, rate_hz);
    }
    rate_Hz = rate_hz;
    on_tick = tick;
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        open_output(&axes[k].out);
        fprintf(axes[k].out.file, "# sample_rate_hz: %lu\ntime_s,reference_um,dac_code%s\n", (unsigned long)rate_hz,
                axes[k].dac.last_code > 0 ? ",command_V" : "");
    }
    return true;
}

bool rdpi_port_sim_reference(uint32_t axis, uint32_t ahead, double *reference_um, double *ahead_um)
{
    input_t *in = &axes[axis].in;
    in->taken = in->next < in->count;
    if (in->taken) {
        *reference_um = in->rows[in->next].reference_um;
        *ahead_um = in->rows[ahead < in->count - in->next ? in->next + ahead : in->count - 1].reference_um;
    }
    return in->taken;
}

bool rdpi_port_write_dac(const uint32_t *codes)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        dac_t *dac = &axes[k].dac;
        if (dac->last_code > 0 && (float)codes[k] > dac->last_code) {
            fail("code %lu does not fit the DAC of --dac; give it the model's dac_bits", (unsigned long)codes[k]);
        }
        dac->code = codes[k];
    }
    return true;
}

void rdpi_port_safe(void)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        axes[k].dac.code = RDPI_SAFE_CODE;
    }
}

bool rdpi_port_watchdog_reset(void)
{
    return false;
}

uint32_t rdpi_port_overruns(void)
{
    return 0; /* the loop waits for the tick */
}

/* Computed as in lib/src/rdpi_f32.c: the same volts to the bit. */
static float dac_V(const dac_t *dac)
{
#if defined(__FP_FAST_FMAF) && defined(__OPTIMIZE__)
    return fmaf((float)dac->code, dac->V_per_code, dac->min_V);
#else
    return dac->min_V + (float)dac->code * dac->V_per_code;
#endif
}

void rdpi_port_read_adc(int32_t *counts)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        counts[k] = RDPI_PORT_NO_READING;
    }
}

uint32_t rdpi_port_cycles(void)
{
    return (uint32_t)clock();
}

bool rdpi_port_send(const uint8_t *bytes, size_t count)
{
    if (telemetry.name != NULL && telemetry.file == NULL) {
        open_output(&telemetry);
    }
    return telemetry.file == NULL || fwrite(bytes, 1, count, telemetry.file) == count;
}

static void write_row(input_t *in, FILE *file, const dac_t *dac)
{
    const row_t *row = &in->rows[in->next];
    double time_s = in->timed ? row->time_s : (double)in->next / rate_Hz;
    fprintf(file, "%.9f,%.9g,%lu", time_s, (double)(float)row->reference_um, (unsigned long)dac->code);
    if (dac->last_code > 0) {
        fprintf(file, ",%.9g", (double)dac_V(dac));
    }
    fputc('\n', file);
    in->next++;
}

/* A tick, and a row for each axis that took one; those of a start-up sweep do not. */
void rdpi_port_idle(void)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        axes[k].in.taken = false;
    }
    on_tick();
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        if (axes[k].in.taken) {
            write_row(&axes[k].in, axes[k].out.file, &axes[k].dac);
        }
    }
}

static void usage(FILE *file)
{
    fputs("Runs the application on the host, one tick per sample of the reference.\n\n"
          "usage: APPLICATION [REFERENCE.csv] [-o DRIVE.csv] [--dac BITS:MIN_V:MAX_V] [--telemetry FILE]\n\n"
          "  REFERENCE.csv   column reference_um (um), optionally time_s (s), which must agree with the\n"
          "                  application's rate; without the name, or for -, standard input\n"
          "  -o DRIVE.csv    time_s, reference_um, dac_code; without it, standard output\n"
          "  --dac B:MIN:MAX also write command_V: the volts of a DAC of B bits (1 to 24) over MIN to MAX\n"
          "  --telemetry F   what a board sends to the host, for rdpi import --telemetry\n\n"
          "Of an application with several axes each axis has a REFERENCE.csv and a -o DRIVE.csv, and each or\n"
          "none a --dac, in the order of the axes.\n",
          file);
}

/* The largest step with which the last code is inside the range, rounded once or twice: that of the host tools,
 * host_tools/rdpi/firmware/parameters.py. */
static float step_V(float min_V, float max_V, float last_code)
{
    float step = (float)(((double)max_V - (double)min_V) / (double)last_code);
    while (step > 0 && ((double)min_V + (double)last_code * (double)step > (double)max_V ||
                        min_V + last_code * step > max_V)) {
        step = nextafterf(step, 0);
    }
    return step;
}

static dac_t read_dac(const char *text)
{
    unsigned bits;
    double min_V, max_V;
    int length = 0;
    if (sscanf(text, "%2u:%lf:%lf%n", &bits, &min_V, &max_V, &length) != 3 || text[length] != '\0' || bits < 1 ||
        bits > 24 || !(fabs(min_V) < 1e6) || !(fabs(max_V) < 1e6) || !((float)min_V < (float)max_V)) {
        fail("--dac %s: give BITS:MIN_V:MAX_V, 1 to 24 bits, MIN_V below MAX_V, e.g. 16:0:100", text);
    }
    float last_code = (float)((1uL << bits) - 1);
    return (dac_t){0, last_code, (float)min_V, step_V((float)min_V, (float)max_V, last_code)};
}

/* The operand of the option at `*k`. */
static const char *operand(int count, char **words, int *k)
{
    if (*k + 1 == count) {
        fail("%s needs a value; see --help", words[*k]);
    }
    return words[++*k];
}

/* The axis that the next word of a kind is for. */
static unsigned next_axis(unsigned *given, const char *word)
{
    if (*given == RDPI_AXES) {
        fail("%s: not understood; the application has %u %s; see --help", word, RDPI_AXES,
             RDPI_AXES > 1 ? "axes" : "axis");
    }
    return (*given)++;
}

static void read_words(int argc, char **argv)
{
    unsigned ins = 0, outs = 0, dacs = 0;
    for (int k = 1; k < argc; k++) {
        const char *word = argv[k];
        if (strcmp(word, "-h") == 0 || strcmp(word, "--help") == 0) {
            usage(stdout);
            exit(EXIT_SUCCESS);
        } else if (strcmp(word, "-o") == 0) {
            word = operand(argc, argv, &k);
            axes[next_axis(&outs, word)].out.name = word;
        } else if (strcmp(word, "--telemetry") == 0) {
            telemetry.name = operand(argc, argv, &k);
        } else if (strcmp(word, "--dac") == 0) {
            word = operand(argc, argv, &k);
            axes[next_axis(&dacs, word)].dac = read_dac(word);
        } else if (word[0] == '-' && word[1] != '\0') {
            fail("%s: not understood; see --help", word);
        } else {
            axes[next_axis(&ins, word)].in.name = word;
        }
    }
    if (RDPI_AXES == 1) {
        axes[0].in.name = ins ? axes[0].in.name : "-";
        axes[0].out.name = outs ? axes[0].out.name : "-";
    } else if (ins != RDPI_AXES || outs != RDPI_AXES || (dacs != 0 && dacs != RDPI_AXES)) {
        fail("the application has %u axes: give so many REFERENCE.csv and -o DRIVE.csv, and so many --dac or none; "
             "see --help", RDPI_AXES);
    }
}

/* The places of all outputs: the drive of each axis, then the telemetry if it is wanted. */
static place_t places[RDPI_AXES + 1];
static unsigned place_count;

static void add_place(const char *name, const char *what)
{
    place_t *place = &places[place_count++];
    const char *slash = strrchr(name, '/');
    *place = (place_t){.name = name, .what = what};
    if (strcmp(name, "-") == 0) {
        place->found = fstat(STDOUT_FILENO, &place->at) == 0;
    } else if (stat(name, &place->at) == 0) {
        place->found = true;
    } else {
        char *folder = slash == NULL ? strdup(".") : strndup(name, (size_t)(slash - name) + 1);
        place->base = slash == NULL ? name : slash + 1;
        place->found = folder != NULL && stat(folder, &place->at) == 0;
        free(folder);
    }
}

static bool same_file(const struct stat *one, const struct stat *other)
{
    return one->st_dev == other->st_dev && one->st_ino == other->st_ino;
}

/* A terminal or /dev/null takes two outputs. */
static bool same_place(const place_t *one, const place_t *other)
{
    if (strcmp(one->name, "-") == 0 && strcmp(other->name, "-") == 0) {
        return true;
    }
    if (!one->found || !other->found || !same_file(&one->at, &other->at)) {
        return false;
    }
    if (one->base == NULL || other->base == NULL) {
        return one->base == other->base && !S_ISCHR(one->at.st_mode);
    }
    return strcmp(one->base, other->base) == 0;
}

/* Two outputs never share a file, whatever they call it. */
static void check_outputs(void)
{
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        add_place(axes[k].out.name, "drive");
    }
    if (telemetry.name != NULL) {
        add_place(telemetry.name, "telemetry");
    }
    for (unsigned k = 0; k < place_count; k++) {
        for (unsigned other = 0; other < k; other++) {
            if (same_place(&places[k], &places[other])) {
                fail("%s: %s", places[k].name,
                     k < RDPI_AXES ? "two axes cannot have the same drive; give them two names"
                                   : "is a drive too; give the telemetry another name");
            }
        }
    }
}

static void read_axis(input_t *in)
{
    bool piped = strcmp(in->name, "-") == 0;
    FILE *file = piped ? stdin : fopen(in->name, "r");
    if (file == NULL) {
        fail("%s: cannot be opened; check the path", in->name);
    }
    struct stat from;
    bool regular = fstat(fileno(file), &from) == 0 && S_ISREG(from.st_mode);
    for (unsigned k = 0; regular && k < place_count; k++) {
        if (places[k].found && places[k].base == NULL && same_file(&from, &places[k].at)) {
            fail("%s: is the reference itself; give the %s another name", places[k].name, places[k].what);
        }
    }
    in->name = piped ? "stdin" : in->name;
    read_reference(in, file);
    if (!piped) {
        fclose(file);
    }
}

int main(int argc, char **argv)
{
    read_words(argc, argv);
    check_outputs();
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        read_axis(&axes[k].in);
    }
    int status = rdpi_port_sim_application();
    for (unsigned k = 0; k < RDPI_AXES; k++) {
        close_output(&axes[k].out);
    }
    close_output(&telemetry);
    return status;
}
