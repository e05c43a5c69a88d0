/* Rust's standard library takes random numbers from bcryptprimitives.dll, which every Windows 10 has, and Wine from 9 on.
 * This one stands in for it, where the program for Windows is tried under an older Wine; it is in no package. */

#include <windows.h>
#include <ntsecapi.h>

__declspec(dllexport) BOOL WINAPI ProcessPrng(PBYTE data, SIZE_T length)
{
    return RtlGenRandom(data, (ULONG)length);
}
