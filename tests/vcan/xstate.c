/*
 * Preloaded into user-mode-linux 6.1 on processors with AMX.
 *
 * There the host's area of vector registers is 11 kB, while that kernel keeps 2696 bytes of it (FP_SIZE in its registers.c). Reading
 * so much works, writing does not: the host takes the whole area or nothing (EFAULT), upon which UML kills init. So here the bytes
 * behind those that UML knows are read first and written back as they were. They are AMX's tiles, which nothing in there uses.
 * Kernels since 6.13 ask the host for the size.
 */

#define _GNU_SOURCE
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static char area[1 << 16]; /* UML has one thread that traces */

long ptrace(enum __ptrace_request request, ...)
{
	va_list arguments;
	va_start(arguments, request);
	pid_t pid = va_arg(arguments, pid_t);
	void *address = va_arg(arguments, void *);
	void *data = va_arg(arguments, void *);
	va_end(arguments);

	if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
		long word; /* the kernel's call stores it, the library's returns it */
		if (syscall(SYS_ptrace, request, pid, address, &word) < 0)
			return -1;
		errno = 0;
		return word;
	}
	if (request == PTRACE_SETREGSET && (unsigned long)address == NT_X86_XSTATE) {
		struct iovec *given = data;
		struct iovec whole = {area, sizeof area};
		if (syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &whole) < 0)
			return -1;
		if (given->iov_len < whole.iov_len) {
			memcpy(area, given->iov_base, given->iov_len);
			data = &whole;
		}
	}
	return syscall(SYS_ptrace, request, pid, address, data);
}
