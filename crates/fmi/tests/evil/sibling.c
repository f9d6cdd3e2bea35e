/* A library beside that of the evil model, which keeps the model's parameter for it. */
#if defined(_WIN32)
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
double sibling_k;
