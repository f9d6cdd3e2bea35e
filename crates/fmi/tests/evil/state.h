/* Where the model keeps what belongs to an instance, and what outlives a reset, chosen by a macro. */

#ifdef SHARED_GLOBALS
static double global_k;
#define K(m) global_k
#elif defined(STATIC_PARAMETERS)
/* As Simulink exports it: made when the library is loaded, and changed by nothing but being set. */
static double global_k = 1;
#define K(m) global_k
#elif defined(UNIQUE_PARAMETERS)
/* What a C++ compiler makes of an inline variable: the loader gives all copies of the library the same one. */
__asm__(".pushsection .data\n.balign 8\n.globl unique_k\n.type unique_k, @gnu_unique_object\n.size unique_k, 8\n"
        "unique_k: .double 1.0\n.popsection");
extern double unique_k;
#define K(m) unique_k
#elif defined(SIBLING_GLOBALS)
extern double sibling_k;
#define K(m) sibling_k
#else
#define K(m) ((m)->k)
#endif

/* A state that no variable shows, which k above a limit sets: of the library, or of an instance, where neither reset nor a saved
   state brings it back. */
#ifdef REMEMBERS
static double remembered;
#define REMEMBERED(m) remembered
#elif defined(REMEMBERS_IN_INSTANCE)
#define REMEMBERED(m) ((m)->remembered)
#define REMEMBERS REMEMBERS_IN_INSTANCE
#endif

#ifdef REMEMBERS
#define REMEMBER(m) do { if (K(m) > REMEMBERS) REMEMBERED(m) = 0.25; } while (0)
#else
#define REMEMBERED(m) 0
#define REMEMBER(m)
#endif

#ifdef INSTANCES
/* As many instances as this can be made in one loaded copy. */
static int n_made;
#endif
