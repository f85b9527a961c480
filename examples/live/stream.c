/* Prints corrected samples of the phone that a running stillcal daemon serves: sensor, t, x, y, z.
 *
 *     cc -O2 -Wall -o stream stream.c && ./stream [SOCKET]
 *
 * Only the C library is needed. Varlink is JSON with a zero byte after each message, which makes each message a
 * C string. The daemon writes numbers and names without spaces around them, so that a few searches read a block;
 * a program that asks other methods too is better served by a JSON library.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

static const char question[] = "{\"method\":\"io.stillcal.Calibration.Stream\",\"parameters\":{\"batch_s\":0.02},"
                               "\"more\":true}";

/* Print one reply; return 1 while more follow. */
static int show(const char *reply) {
    if (strncmp(reply, "{\"error\"", 8) == 0) { /* TooSlow: this program did not read fast enough */
        fprintf(stderr, "%s\n", reply);
        exit(1);
    }
    const char *rows = strstr(reply, "\"samples\":[[");
    const char *raw = strstr(reply, "\"calibrated\":true") ? "" : "raw_";
    const char *name = strstr(reply, "\"sensor\":\"gyroscope\"") ? "gyroscope" : "accelerometer";
    if (rows) {
        const char *at = rows + strlen("\"samples\":[");
        while (*at == '[') {
            double v[4];
            for (int i = 0; i < 4; i++) {
                char *end;
                v[i] = strtod(at + 1, &end);
                at = end; /* at the comma, or at the row's bracket */
            }
            printf("%s%s %.17g %.17g %.17g %.17g\n", raw, name, v[0], v[1], v[2], v[3]);
            at += at[1] == ',' ? 2 : 1; /* over "]," or "]" */
        }
    } else {
        fprintf(stderr, "%s\n", reply);
    }
    fflush(stdout);
    return strstr(reply, "\"continues\":true") != NULL;
}

int main(int argc, char **argv) {
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    const char *path = argc > 1 ? argv[1] : "/run/stillcal/io.stillcal.Calibration";
    if (strlen(path) >= sizeof address.sun_path) {
        fprintf(stderr, "%s: the path is too long for a socket\n", path);
        return 1;
    }
    strcpy(address.sun_path, path);
    int line = socket(AF_UNIX, SOCK_STREAM, 0);
    if (line < 0 || connect(line, (struct sockaddr *)&address, sizeof address) < 0 ||
        write(line, question, sizeof question) != sizeof question) { /* with its zero byte */
        perror(path);
        return 1;
    }
    size_t used = 0, room = 65536;
    char *buffer = malloc(room);
    ssize_t got;
    while (buffer && (got = read(line, buffer + used, room - used)) > 0) {
        used += (size_t)got;
        char *begin = buffer, *end;
        while ((end = memchr(begin, 0, used - (size_t)(begin - buffer)))) {
            if (!show(begin))
                return 0;
            begin = end + 1;
        }
        used -= (size_t)(begin - buffer);
        memmove(buffer, begin, used);
        if (used == room)
            buffer = realloc(buffer, room *= 2);
    }
    fprintf(stderr, "the daemon has gone\n");
    return 1;
}
