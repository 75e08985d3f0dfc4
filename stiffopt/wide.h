/* Registers of doubles, and functions compiled for several processors, of which the loader chooses. */
#ifndef WIDE_H
#define WIDE_H

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define LANES 8
/* Neither aligned as a whole nor of a type of its own: they lie in arrays of double. */
typedef double wide __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

#if defined __x86_64__ && defined __gnu_linux__
/* What it calls is compiled with it. */
#define HOT __attribute__((target_clones("avx512f", "avx2", "default"), flatten))
#else
#define HOT
#endif
#endif
