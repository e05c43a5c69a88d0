//! slitpose for Python: the module `slitpose._native`, on which the package in `slitpose/` rests.
//!
//! Results are dictionaries of numpy arrays, which the package turns into classes of its own. Long work runs without the
//! interpreter's lock on a thread with a large stack, and ends early at Ctrl-C.

mod arrays;
mod calibration;
mod captures;
mod scene;
mod work;

use pyo3::prelude::*;
use slitpose_head::scene_file::SHIPPED;
use slitpose_model::AXES;

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("SlitposeError", py.get_type::<work::SlitposeError>())?;
    module.add("COLUMNS", arrays::listed())?;
    module.add("CELL_STATUSES", scene::CELL_STATUSES.map(|status| status.as_str()))?;
    module.add("READINGS", captures::READINGS)?;
    module.add("AXES", AXES)?;
    module.add("SCENES", SHIPPED.map(|shipped| shipped.name))?;
    module.add_class::<captures::Captures>()?;
    module.add_class::<scene::Scene>()?;
    module.add_class::<calibration::Calibration>()?;
    module.add_function(wrap_pyfunction!(calibration::calibrate, module)?)?;
    module.add_function(wrap_pyfunction!(work::limit_cores, module)?)?;
    module.add_function(wrap_pyfunction!(work::fence, module)?)?;
    module.add_function(wrap_pyfunction!(arrays::rotation_vectors, module)?)?;
    module.add_function(wrap_pyfunction!(arrays::quaternions, module)?)
}
