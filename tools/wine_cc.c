/* A C compiler for tests under Wine, which has none: passes its command line to tools/wine_cc.py on the host. */
#include <winsock2.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void send_text(SOCKET to, const char *text)
{
    send(to, text, (int)strlen(text) + 1, 0);
}

int main(int argc, char **argv)
{
    WSADATA data;
    struct sockaddr_in address = {0};
    char buffer[4096], folder[4096];
    int n, status = 1, is_first = 1;
    const char *port = getenv("WINE_CC_PORT");
    WSAStartup(MAKEWORD(2, 2), &data);
    SOCKET host = socket(AF_INET, SOCK_STREAM, 0);
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    address.sin_port = htons((unsigned short)atoi(port ? port : "0"));
    if (connect(host, (struct sockaddr *)&address, sizeof address)) {
        fprintf(stderr, "tools/wine_cc.py is not running\n");
        return 1;
    }
    GetCurrentDirectoryA(sizeof folder, folder);
    send_text(host, folder);
    for (int i = 1; i < argc; i++)
        send_text(host, argv[i]);
    shutdown(host, SD_SEND);
    /* The first byte is the exit status; the output of the compiler follows. */
    while ((n = recv(host, buffer, sizeof buffer, 0)) > 0) {
        if (is_first)
            status = buffer[0];
        fwrite(buffer + is_first, 1, n - is_first, status ? stderr : stdout);
        is_first = 0;
    }
    return status;
}
