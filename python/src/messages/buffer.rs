//! Arrays of NumPy on bytes that Rust owns, and the numbers in buffers of Python.
//!
//! This wraps two interfaces in C: the buffer protocol of Python, and the table of functions of NumPy.

#![allow(unsafe_code)]

use std::ffi::{CStr, c_int, c_void};

use bytes::Bytes;
use downbeat_msgs::definitions::Primitive;
use pyo3::exceptions::PyBufferError;
use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyByteArray, PyBytes};

/// The bytes of a message, read-only for Python. Views of them keep them alive.
#[pyclass(frozen, module = "downbeat._core")]
pub(crate) struct SharedBytes {
    pub(super) bytes: Bytes,
    /// Whether these are the defaults of a type: arrays of a new message are copies, which can be written.
    pub(super) is_default: bool,
}

#[pymethods]
impl SharedBytes {
    /// # Safety
    /// Called by Python only, with a `view` to fill.
    unsafe fn __getbuffer__(slf: Bound<'_, Self>, view: *mut ffi::Py_buffer, flags: c_int) -> PyResult<()> {
        let bytes = &slf.get().bytes;
        let length = ffi::Py_ssize_t::try_from(bytes.len())
            .map_err(|_| PyBufferError::new_err("the message is too large for a buffer"))?;
        // SAFETY: the view keeps `slf` alive, which keeps the bytes alive and never changes them; the view is
        // read-only.
        let result = unsafe {
            ffi::PyBuffer_FillInfo(
                view,
                slf.as_ptr(),
                bytes.as_ptr().cast_mut().cast::<c_void>(),
                length,
                1,
                flags,
            )
        };
        if result == 0 { Ok(()) } else { Err(PyErr::fetch(slf.py())) }
    }
}

/// What is used of NumPy, looked up once.
pub(super) struct NumPy {
    pub(super) asarray: Py<PyAny>,
    pub(super) array_equal: Py<PyAny>,
    pub(super) ndarray: Py<PyAny>,
    dtypes: [Py<PyAny>; Primitive::ALL.len()],
    new_from_descr: NewFromDescr,
    set_base_object: SetBaseObject,
}

/// `PyArray_NewFromDescr`: class, type of elements (which it takes over), dimensions, lengths, strides, data,
/// flags, object.
type NewFromDescr = unsafe extern "C" fn(
    *mut ffi::PyTypeObject,
    *mut ffi::PyObject,
    c_int,
    *const isize,
    *const isize,
    *mut c_void,
    c_int,
    *mut ffi::PyObject,
) -> *mut ffi::PyObject;

/// `PyArray_SetBaseObject`: array, object that owns the data (which it takes over).
type SetBaseObject = unsafe extern "C" fn(*mut ffi::PyObject, *mut ffi::PyObject) -> c_int;

const NEW_FROM_DESCR: usize = 94;
const SET_BASE_OBJECT: usize = 282;
const WRITEABLE: c_int = 0x400;

impl NumPy {
    pub(super) fn get(py: Python<'_>) -> PyResult<&'static Self> {
        static NUMPY: PyOnceLock<NumPy> = PyOnceLock::new();
        NUMPY.get_or_try_init(py, || {
            let numpy = py.import("numpy")?;
            let function = |name: &str| numpy.getattr(name).map(Bound::unbind);
            let of = |primitive: Primitive| Ok(numpy.call_method1("dtype", (dtype(primitive),))?.unbind());
            let dtypes =
                Primitive::ALL.iter().map(|primitive| of(*primitive)).collect::<PyResult<Vec<_>>>()?;
            // In NumPy 1 the module has another name.
            let core = py.import("numpy._core._multiarray_umath");
            let core = core.or_else(|_| py.import("numpy.core._multiarray_umath"))?;
            let table = core.getattr("_ARRAY_API")?;
            // SAFETY: NumPy documents the capsule as a table of pointers to functions, whose numbers and
            // signatures are part of its binary interface since version 1.7
            // (numpy/_core/code_generators/numpy_api.py).
            let (new_from_descr, set_base_object) = unsafe {
                let table =
                    ffi::PyCapsule_GetPointer(table.as_ptr(), std::ptr::null()).cast::<*const c_void>();
                if table.is_null() {
                    return Err(PyErr::fetch(py));
                }
                (
                    std::mem::transmute::<*const c_void, NewFromDescr>(*table.add(NEW_FROM_DESCR)),
                    std::mem::transmute::<*const c_void, SetBaseObject>(*table.add(SET_BASE_OBJECT)),
                )
            };
            Ok(Self {
                asarray: function("asarray")?,
                array_equal: function("array_equal")?,
                ndarray: function("ndarray")?,
                dtypes: dtypes.try_into().map_err(|_| PyBufferError::new_err("a dtype is missing"))?,
                new_from_descr,
                set_base_object,
            })
        })
    }

    /// A read-only array on a part of shared bytes if it is aligned in memory, otherwise on a copy. An array
    /// of a new message is a copy that can be written.
    pub(super) fn view(
        &self,
        source: &Bound<'_, SharedBytes>,
        primitive: Primitive,
        offset: usize,
        length: usize,
    ) -> PyResult<Py<PyAny>> {
        let py = source.py();
        let shared = source.get();
        let part = shared.bytes.get(offset..offset + length).unwrap_or_default();
        if shared.is_default || part.is_empty() {
            return self.copy(py, primitive, part);
        }
        let count = length / primitive.size();
        if part.as_ptr().align_offset(primitive.size()) == 0 {
            // SAFETY: the bytes belong to the base and never change.
            return unsafe { self.on(source.as_any(), primitive, count, part.as_ptr(), 0) };
        }
        let copy = PyBytes::new(py, part);
        // SAFETY: as above.
        unsafe { self.on(copy.as_any(), primitive, count, copy.as_bytes().as_ptr(), 0) }
    }

    /// A writable array with these little-endian values.
    pub(super) fn copy(&self, py: Python<'_>, primitive: Primitive, bytes: &[u8]) -> PyResult<Py<PyAny>> {
        let count = bytes.len() / primitive.size();
        let copy = PyByteArray::new(py, bytes);
        // SAFETY: the bytes belong to the base, which nobody else has, so that nobody resizes it.
        unsafe { self.on(copy.as_any(), primitive, count, copy.data(), WRITEABLE) }
    }

    /// An array of `count` numbers at `data`.
    ///
    /// # Safety
    /// The numbers must belong to `base`, stay there, and be written by nobody else.
    unsafe fn on(
        &self,
        base: &Bound<'_, PyAny>,
        primitive: Primitive,
        count: usize,
        data: *const u8,
        flags: c_int,
    ) -> PyResult<Py<PyAny>> {
        let py = base.py();
        let length = isize::try_from(count).unwrap_or(0);
        // SAFETY: the functions are those of NumPy. The first takes over the type of the elements, the second
        // the base, so that both get a new reference; with a length of 0 the data is not used.
        unsafe {
            let array = (self.new_from_descr)(
                self.ndarray.as_ptr().cast(),
                self.dtypes[primitive as usize].clone_ref(py).into_ptr(),
                1,
                &raw const length,
                std::ptr::null(),
                data.cast_mut().cast(),
                flags,
                std::ptr::null_mut(),
            );
            let array = Bound::from_owned_ptr_or_err(py, array)?;
            if (self.set_base_object)(array.as_ptr(), base.clone().into_ptr()) != 0 {
                return Err(PyErr::fetch(py));
            }
            Ok(array.unbind())
        }
    }
}

/// Calls `with` with the bytes of a contiguous buffer of any type.
///
/// # Errors
/// The exception of an object that has no such buffer.
pub(super) fn with_bytes<T>(object: &Bound<'_, PyAny>, with: impl FnOnce(&[u8]) -> T) -> PyResult<T> {
    let view = View::get(object, ffi::PyBUF_SIMPLE)?;
    Ok(with(view.bytes()))
}

/// Calls `with` with the bytes of an object that holds numbers of this type in one dimension, one after
/// another. Returns `None` for others.
pub(super) fn with_values<T>(
    object: &Bound<'_, PyAny>,
    primitive: Primitive,
    with: impl FnOnce(&[u8]) -> T,
) -> Option<T> {
    // SAFETY: the function only looks at the type.
    if unsafe { ffi::PyObject_CheckBuffer(object.as_ptr()) } == 0 {
        return None;
    }
    let view = View::get(object, ffi::PyBUF_FORMAT | ffi::PyBUF_C_CONTIGUOUS).ok()?;
    let is_same = view.0.ndim == 1
        && usize::try_from(view.0.itemsize).is_ok_and(|size| size == primitive.size())
        && view.format().is_some_and(|format| formats(primitive).contains(&format));
    is_same.then(|| with(view.bytes()))
}

/// The name of the primitive in NumPy.
pub(super) fn dtype(primitive: Primitive) -> &'static str {
    match primitive {
        Primitive::Byte | Primitive::Char => "uint8",
        other => other.as_str(),
    }
}

/// The characters of the module `struct` for these numbers. Their size is checked as well.
fn formats(primitive: Primitive) -> &'static [u8] {
    match primitive {
        Primitive::Bool => b"?",
        Primitive::Byte | Primitive::Char | Primitive::UInt8 => b"B",
        Primitive::Int8 => b"b",
        Primitive::Int16 => b"h",
        Primitive::UInt16 => b"H",
        Primitive::Int32 | Primitive::Int64 => b"ilq",
        Primitive::UInt32 | Primitive::UInt64 => b"ILQ",
        Primitive::Float32 => b"f",
        Primitive::Float64 => b"d",
    }
}

/// A buffer of Python, which is released when this is dropped.
struct View(ffi::Py_buffer);

impl View {
    fn get(object: &Bound<'_, PyAny>, flags: c_int) -> PyResult<Self> {
        let mut view = Self(ffi::Py_buffer::new());
        // SAFETY: the buffer is filled only on success; a buffer that is not filled has no owner, and
        // releasing it does nothing.
        if unsafe { ffi::PyObject_GetBuffer(object.as_ptr(), &raw mut view.0, flags) } == 0 {
            Ok(view)
        } else {
            Err(PyErr::fetch(object.py()))
        }
    }

    fn bytes(&self) -> &[u8] {
        let length = usize::try_from(self.0.len).unwrap_or(0);
        if self.0.buf.is_null() || length == 0 {
            return &[];
        }
        // SAFETY: the owner keeps the memory as long as the view is held. No Python code, which could change
        // it, runs as long as the bytes are borrowed: the callers only copy them.
        unsafe { std::slice::from_raw_parts(self.0.buf.cast::<u8>().cast_const(), length) }
    }

    /// The only character of the format; without one, these are bytes.
    fn format(&self) -> Option<u8> {
        if self.0.format.is_null() {
            return Some(b'B');
        }
        // SAFETY: the format is a text that ends with a zero, as long as the view is held.
        match unsafe { CStr::from_ptr(self.0.format) }.to_bytes() {
            [format] | [b'@' | b'=' | b'<', format] => Some(*format),
            _ => None,
        }
    }
}

impl Drop for View {
    fn drop(&mut self) {
        // SAFETY: the interpreter is attached, because a view does not leave the functions above; the buffer
        // was filled or has no owner.
        unsafe { ffi::PyBuffer_Release(&raw mut self.0) }
    }
}
