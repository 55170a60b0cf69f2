/* bcryptprimitives.dll for wine 8, which has none: Rust's standard library asks this library of Windows 10 for the random
 * numbers that its hash tables start with. The symbol behind RtlGenRandom is SystemFunction036 of advapi32.dll. */
#include <windows.h>

BOOLEAN NTAPI SystemFunction036(PVOID buffer, ULONG size);

__declspec(dllexport) BOOL WINAPI ProcessPrng(PBYTE buffer, SIZE_T size) { return SystemFunction036(buffer, (ULONG)size); }
