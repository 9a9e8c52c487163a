/* For user-mode Linux 6.1 on processors whose registers are larger than it has room for (AMX: 11 KB).
 *
 * The host's kernel takes a set of registers only whole: what is missing behind those given are those that are there.
 * Loaded before the C library (LD_PRELOAD), whose ptrace() it stands before. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

static unsigned char whole[1 << 16];

long ptrace(enum __ptrace_request request, ...)
{
	static long (*library)(enum __ptrace_request, ...);
	va_list arguments;
	va_start(arguments, request);
	pid_t process = va_arg(arguments, pid_t);
	void *address = va_arg(arguments, void *);
	void *data = va_arg(arguments, void *);
	va_end(arguments);

	if (!library)
		library = (long (*)(enum __ptrace_request, ...))dlsym(RTLD_NEXT, "ptrace");
	if (request == PTRACE_SETREGSET && (long)address == NT_X86_XSTATE) {
		const struct iovec *given = data;
		struct iovec there = {whole, sizeof whole};
		if (!library(PTRACE_GETREGSET, process, address, &there) && there.iov_len > given->iov_len) {
			memcpy(whole, given->iov_base, given->iov_len);
			return library(request, process, address, &there);
		}
	}
	return library(request, process, address, data);
}
