//! Libraries of others that the operator's page and the report draw with: three.js and uPlot, as
//! they are. `NOTICE.md` names their versions, licences and sources.

/// Core of three.js, a module.
pub const THREE_CORE: &str = include_str!("../three.core.min.js");
/// three.js, a module that imports `./three.core.min.js`.
pub const THREE: &str = include_str!("../three.module.min.js");
/// Camera control of three.js, a module that imports `./three.module.min.js`.
pub const ORBIT_CONTROLS: &str = include_str!("../OrbitControls.js");
/// uPlot, a module that imports nothing and ends with its only `export`.
pub const UPLOT: &str = include_str!("../uPlot.esm.js");
/// Style of uPlot.
pub const UPLOT_STYLE: &str = include_str!("../uPlot.min.css");
/// Name, version, licence and source of each.
pub const NOTICE: &str = include_str!("../NOTICE.md");
/// Licence of three.js.
pub const THREE_LICENSE: &str = include_str!("../LICENSE.three.txt");
/// Licence of uPlot.
pub const UPLOT_LICENSE: &str = include_str!("../LICENSE.uPlot.txt");
