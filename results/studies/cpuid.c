/* Answers the instruction CPUID as an EPYC of family 25 does, so that libraries choose their instructions as there.
   AVX-512 and AMX are hidden. It needs Linux and a processor with CPUID faulting.
   cc -O2 -shared -fPIC -o cpuid.so results/studies/cpuid.c, then LD_PRELOAD=cpuid.so (processors.py). */
#define _GNU_SOURCE
#include <asm/prctl.h>
#include <cpuid.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unistd.h>

static const char BRAND[48] = "AMD EPYC 7763 64-Core Processor";

static void answer(int number, siginfo_t *info, void *context) {
    greg_t *r = ((ucontext_t *)context)->uc_mcontext.gregs;
    const unsigned char *code = (const unsigned char *)r[REG_RIP];
    if (code[0] != 0x0f || code[1] != 0xa2) {
        signal(SIGSEGV, SIG_DFL); /* a real fault */
        return;
    }
    unsigned leaf = r[REG_RAX], sub = r[REG_RCX], a, b, c, d;
    syscall(SYS_arch_prctl, ARCH_SET_CPUID, 1);
    __cpuid_count(leaf, sub, a, b, c, d);
    syscall(SYS_arch_prctl, ARCH_SET_CPUID, 0);
    if (leaf == 0 || leaf == 0x80000000) {
        a = leaf ? 0x80000021 : 0x10;
        memcpy(&b, "Auth", 4), memcpy(&d, "enti", 4), memcpy(&c, "cAMD", 4);
    } else if (leaf == 1) {
        a = 0x00a00f11; /* family 25, model 1 */
    } else if (leaf == 7) {
        if (sub == 0) { /* bits 16, 17, 21, 26 to 28, 30 and 31 of EBX, and so on, are of AVX-512 and AMX */
            b &= ~(1u << 16 | 1u << 17 | 1u << 21 | 1u << 26 | 1u << 27 | 1u << 28 | 1u << 30 | 1u << 31);
            c &= ~(1u << 1 | 1u << 6 | 1u << 11 | 1u << 12 | 1u << 14);
            d &= ~(1u << 2 | 1u << 3 | 1u << 8 | 1u << 22 | 1u << 23 | 1u << 24 | 1u << 25);
            a = 0;
        } else {
            a = b = c = d = 0;
        }
    } else if (leaf == 2 || leaf == 4 || (leaf > 0x10 && leaf < 0x40000000)) {
        a = b = c = d = 0; /* caches are described by other leaves */
    } else if (leaf >= 0x80000002 && leaf <= 0x80000004) {
        const char *part = BRAND + 16 * (leaf - 0x80000002);
        memcpy(&a, part, 4), memcpy(&b, part + 4, 4), memcpy(&c, part + 8, 4), memcpy(&d, part + 12, 4);
    } else if (leaf == 0x80000005) {
        a = b = 0xff40ff40, c = d = 0x20080140; /* 32 KiB of L1 */
    } else if (leaf == 0x80000006) {
        a = b = 0x48002200, c = 0x02006140, d = 0x01009140; /* 512 KiB of L2, 32 MiB of L3 */
    } else if (leaf == 0x8000001d) {
        a = sub < 4 ? (unsigned[]){0x121, 0x122, 0x143, 0x163}[sub] : 0;
        b = sub < 2 ? 0x01c0003f : sub == 2 ? 0x01c0003f : 0x03c0003f;
        c = sub < 2 ? 63 : sub == 2 ? 1023 : 32767, d = 0;
    }
    r[REG_RAX] = a, r[REG_RBX] = b, r[REG_RCX] = c, r[REG_RDX] = d;
    r[REG_RIP] += 2;
}

__attribute__((constructor)) static void begin(void) {
    struct sigaction action = {.sa_sigaction = answer, .sa_flags = SA_SIGINFO | SA_NODEFER};
    sigaction(SIGSEGV, &action, NULL);
    if (syscall(SYS_arch_prctl, ARCH_SET_CPUID, 0)) perror("this processor cannot hide CPUID");
}
