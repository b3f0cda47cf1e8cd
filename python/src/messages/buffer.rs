//! Arrays of NumPy on bytes that Rust owns.

#![allow(unsafe_code)] // The buffer protocol is a C interface.

use std::ffi::{CStr, c_int, c_void};

use bytes::Bytes;
use downbeat_msgs::definitions::Primitive;
use pyo3::exceptions::PyBufferError;
use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyByteArray, PyBytes};

use super::types::dtype;

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
        // SAFETY: the view keeps `slf` alive, which keeps the bytes alive and never changes them; the view is read-only.
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
    frombuffer: Py<PyAny>,
    dtypes: [Py<PyAny>; Primitive::ALL.len()],
}

impl NumPy {
    pub(super) fn get(py: Python<'_>) -> PyResult<&'static Self> {
        static NUMPY: PyOnceLock<NumPy> = PyOnceLock::new();
        NUMPY.get_or_try_init(py, || {
            let numpy = py.import("numpy")?;
            let function = |name: &str| numpy.getattr(name).map(Bound::unbind);
            let of = |primitive: Primitive| Ok(numpy.call_method1("dtype", (dtype(primitive),))?.unbind());
            let dtypes =
                Primitive::ALL.iter().map(|primitive| of(*primitive)).collect::<PyResult<Vec<_>>>()?;
            Ok(Self {
                asarray: function("asarray")?,
                array_equal: function("array_equal")?,
                ndarray: function("ndarray")?,
                frombuffer: function("frombuffer")?,
                dtypes: dtypes.try_into().map_err(|_| PyBufferError::new_err("a dtype is missing"))?,
            })
        })
    }

    pub(super) fn dtype(&self, primitive: Primitive) -> &Py<PyAny> {
        &self.dtypes[primitive as usize]
    }

    /// A read-only array on a part of shared bytes if it is aligned in memory, otherwise on a copy. An array of a new message
    /// is a copy that can be written.
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
        let dtype = self.dtype(primitive);
        let array = if part.as_ptr().align_offset(primitive.size()) == 0 {
            self.frombuffer.bind(py).call1((source, dtype, length / primitive.size(), offset))?
        } else {
            self.frombuffer.bind(py).call1((PyBytes::new(py, part), dtype))?
        };
        Ok(array.unbind())
    }

    /// A writable array with these little-endian values.
    pub(super) fn copy(&self, py: Python<'_>, primitive: Primitive, bytes: &[u8]) -> PyResult<Py<PyAny>> {
        let dtype = self.dtype(primitive);
        if bytes.is_empty() {
            return Ok(self.ndarray.bind(py).call1((0, dtype))?.unbind());
        }
        Ok(self.frombuffer.bind(py).call1((PyByteArray::new(py, bytes), dtype))?.unbind())
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

/// Calls `with` with the bytes of an object that holds numbers of this type in one dimension, one after another. Returns `None`
/// for others.
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
        // SAFETY: the buffer is filled only on success; a buffer that is not filled has no owner, and releasing it does nothing.
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
        // SAFETY: the owner keeps the memory as long as the view is held. No Python code, which could change it, runs as long as
        // the bytes are borrowed: the callers only copy them.
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
        // SAFETY: the interpreter is attached, because a view does not leave the functions above; the buffer was filled or has no
        // owner.
        unsafe { ffi::PyBuffer_Release(&raw mut self.0) }
    }
}
