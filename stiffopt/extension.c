/* The extension module's own part: it is loaded for the functions of the other files, which Python calls by ctypes,
   CasADi and IPOPT by their names. Without Python's headers it is a library all the same. */

#if __has_include(<Python.h>)
#define Py_LIMITED_API 0x030b0000
#include <Python.h>

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_native"};

PyMODINIT_FUNC PyInit__native(void) { return PyModuleDef_Init(&definition); }
#endif
