/* Inline caches for the C code that mypyc writes, included before each of its modules.

   mypyc looks up a global that is not `Final`, as a function of `math`, in the dictionary of its module at
   each use, and makes a NamedTuple by a call of Python. Each place of the code remembers here what it
   found last, and checks that nothing has changed since: the version of a dictionary or of a type is
   another one after each change, and no two have the same. So the result is that of CPython's own
   functions, which remain the way for everything else.

   CPython 3.11 has these versions. Later ones forbid or remove them; there is no cache then. */

#include <Python.h>
#include <CPy.h>

#if PY_VERSION_HEX < 0x030C0000 && defined(__GNUC__)

/* ------------------------------------------------------------------ items of dictionaries */

typedef struct {
    uint64_t version; /* 0: nothing is remembered; no dictionary has it */
    PyObject *key;
    PyObject *value; /* the dictionary owns it, as long as its version is this */
} ItemCache;

static inline PyObject *cached_item(PyObject *dict, PyObject *key, ItemCache *cache) {
    if (!PyDict_CheckExact(dict)) {
        return CPyDict_GetItem(dict, key);
    }
    uint64_t version = ((PyDictObject *)dict)->ma_version_tag;
    if (version == cache->version && key == cache->key) {
        return Py_NewRef(cache->value);
    }
    PyObject *value = CPyDict_GetItem(dict, key);
    /* A string as the key compares without code that could change the dictionary. */
    if (value != NULL && PyUnicode_CheckExact(key)) {
        *cache = (ItemCache){version, key, value};
    }
    return value;
}

#define CPyDict_GetItem(dict, key)            \
    __extension__({                           \
        static ItemCache item_cache;          \
        cached_item((dict), (key), &item_cache); \
    })

/* ------------------------------------------------------------------ instances of a class */

static inline int cached_is_subtype(PyObject *object, PyTypeObject *of, PyTypeObject **cache) {
    PyTypeObject *type = Py_TYPE(object);
    if (type == of || (type == *cache && type->tp_version_tag != 0)) {
        return 1;
    }
    return PyType_IsSubtype(type, of);
}

/* ------------------------------------------------------------------ new named tuples */

typedef struct {
    PyTypeObject *type; /* a class made by NamedTuple, or NULL */
    unsigned int version;
    Py_ssize_t fields;
} TupleCache;

/* The number of fields of a class that NamedTuple made; 0 for any other class. */
static Py_ssize_t fields_of_named_tuple(PyTypeObject *type) {
    static PyObject *name, *code, *filename;
    if (name == NULL) {
        name = PyUnicode_InternFromString("_fields");
    }
    if (type->tp_base != &PyTuple_Type || type->tp_init != PyBaseObject_Type.tp_init
        || type->tp_alloc != PyType_GenericAlloc || type->tp_dictoffset || type->tp_weaklistoffset
        || Py_TYPE(type) != &PyType_Type) {
        return 0;
    }
    (void)code, (void)filename;
    PyObject *fields = PyDict_GetItemWithError(type->tp_dict, name);
    return fields != NULL && PyTuple_CheckExact(fields) ? PyTuple_GET_SIZE(fields) : 0;
}

static inline PyObject *cached_call(
    PyObject *callable, PyObject *const *args, size_t flagged, PyObject *names, TupleCache *cache) {
    PyTypeObject *type = (PyTypeObject *)callable;
    if (names == NULL && Py_IS_TYPE(callable, &PyType_Type)) {
        Py_ssize_t given = PyVectorcall_NARGS(flagged);
        if (type != cache->type || type->tp_version_tag != cache->version) {
            Py_ssize_t fields = type->tp_version_tag == 0 ? 0 : fields_of_named_tuple(type);
            *cache = (TupleCache){type, type->tp_version_tag, fields};
        }
        if (given == cache->fields && given > 0) {
            PyObject *made = PyType_GenericAlloc(type, given);
            if (made != NULL) {
                for (Py_ssize_t i = 0; i < given; i++) {
                    PyTuple_SET_ITEM(made, i, Py_NewRef(args[i]));
                }
            }
            return made;
        }
    }
    return PyObject_Vectorcall(callable, args, flagged, names);
}

#define PyObject_Vectorcall(callable, args, flagged, names)                     \
    __extension__({                                                              \
        static TupleCache tuple_cache;                                           \
        cached_call((callable), (args), (flagged), (names), &tuple_cache);       \
    })

#undef PyObject_TypeCheck
#define PyObject_TypeCheck(object, of)                                  \
    __extension__({                                                      \
        static PyTypeObject *type_cache;                                 \
        PyObject *checked = (PyObject *)(object);                        \
        int is = cached_is_subtype(checked, (of), &type_cache);          \
        if (is) type_cache = Py_TYPE(checked);                           \
        is;                                                              \
    })

#endif
