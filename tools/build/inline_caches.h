/* Inline caches for the C code that mypyc writes. `headland compile` includes them before each module.

   mypyc looks up a global that is not `Final`, such as a function of `math`, in the dictionary of its
   module at each use. It makes a NamedTuple by a call of Python code, and walks the bases of a class at
   each cast. Here each place of the code remembers what it found last. It looks again if the version of
   the dictionary or of the type is another one: CPython gives a new version after each change, and none
   twice. So the results are those of CPython's own functions.

   A class whose `__new__` somebody replaces is an exception: NamedTuple itself refuses that.

   CPython 3.11 has these versions. Later ones deprecate them; there are no caches then. */

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

#define CPyDict_GetItem(dict, key)                                              \
    __extension__({                                                             \
        static ItemCache item_cache;                                            \
        cached_item((dict), (key), &item_cache);                                \
    })

/* ------------------------------------------------------------------ instances of a class */

/* Most classes have one base, so this ends after a step or two. `PyType_IsSubtype` searches a tuple. */
static inline int is_instance(PyObject *object, PyTypeObject *of) {
    for (PyTypeObject *type = Py_TYPE(object); type != NULL; type = type->tp_base) {
        if (type == of) {
            return 1;
        }
    }
    return PyType_IsSubtype(Py_TYPE(object), of);
}

#undef PyObject_TypeCheck
#define PyObject_TypeCheck(object, of) is_instance((PyObject *)(object), (of))

/* ------------------------------------------------------------------ new named tuples */

typedef struct {
    PyTypeObject *type; /* the class that was called last, or NULL */
    unsigned int version;
    PyObject *fields;   /* a tuple of names; NULL if NamedTuple did not make the class */
    PyObject *defaults; /* a dictionary of values by name */
} TupleCache;

/* What this class is. The class owns the fields and the defaults, as long as its version is this. */
static TupleCache tuple_class(PyTypeObject *type) {
    TupleCache found = {type, type->tp_version_tag, NULL, NULL};
    if (type->tp_version_tag == 0 || type->tp_base != &PyTuple_Type || !Py_IS_TYPE(type, &PyType_Type)
        || type->tp_init != PyBaseObject_Type.tp_init || type->tp_alloc != PyType_GenericAlloc
        || type->tp_dictoffset || type->tp_weaklistoffset) {
        return found;
    }
    PyObject *fields = PyDict_GetItemString(type->tp_dict, "_fields");
    PyObject *defaults = PyDict_GetItemString(type->tp_dict, "_field_defaults");
    if (fields != NULL && PyTuple_CheckExact(fields) && defaults != NULL
        && PyDict_CheckExact(defaults)) {
        found.fields = fields, found.defaults = defaults;
    }
    return found;
}

/* A named tuple of these values and, unless `exact`, the defaults of the others. NULL if Python has to
   make it. */
static inline PyObject *named_tuple(
    PyObject *class, PyObject *const *values, Py_ssize_t given, int exact, TupleCache *cache) {
    PyTypeObject *type = (PyTypeObject *)class;
    if (type != cache->type || type->tp_version_tag != cache->version) {
        *cache = tuple_class(type);
    }
    if (cache->fields == NULL) {
        return NULL;
    }
    Py_ssize_t all = PyTuple_GET_SIZE(cache->fields);
    if (given > all || (given < all && exact) || all == 0) {
        return NULL;
    }
    PyObject *made = PyType_GenericAlloc(type, all);
    if (made == NULL) {
        return NULL;
    }
    for (Py_ssize_t i = 0; i < given; i++) {
        PyTuple_SET_ITEM(made, i, Py_NewRef(values[i]));
    }
    for (Py_ssize_t i = given; i < all; i++) {
        PyObject *value = PyDict_GetItemWithError(
            cache->defaults, PyTuple_GET_ITEM(cache->fields, i));
        if (value == NULL) { /* Python says that a value is missing */
            Py_DECREF(made);
            return NULL;
        }
        PyTuple_SET_ITEM(made, i, Py_NewRef(value));
    }
    return made;
}

/* By the class, or by `tuple.__new__(class, values)`. */
static inline PyObject *cached_call(
    PyObject *callable, PyObject *const *args, size_t flagged, PyObject *names, TupleCache *cache) {
    static PyObject *new; /* borrowed: `tuple` has it for good */
    if (new == NULL) {
        new = PyDict_GetItemString(PyTuple_Type.tp_dict, "__new__");
    }
    Py_ssize_t given = PyVectorcall_NARGS(flagged);
    PyObject *made = NULL;
    if (names != NULL) {
    } else if (Py_IS_TYPE(callable, &PyType_Type)) {
        made = named_tuple(callable, args, given, 0, cache);
    } else if (
        callable == new && given == 2 && PyType_Check(args[0]) && PyTuple_CheckExact(args[1])) {
        PyTupleObject *values = (PyTupleObject *)args[1];
        made = named_tuple(args[0], values->ob_item, Py_SIZE(values), 1, cache);
    }
    if (made != NULL || PyErr_Occurred()) {
        return made;
    }
    return PyObject_Vectorcall(callable, args, flagged, names);
}

#define PyObject_Vectorcall(callable, args, flagged, names)                     \
    __extension__({                                                             \
        static TupleCache tuple_cache;                                          \
        cached_call((callable), (args), (flagged), (names), &tuple_cache);      \
    })

#endif
