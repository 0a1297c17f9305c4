//! Hierarchical point-based light transport.
#![forbid(unsafe_code)]

pub use hplt_basis as basis;
pub use hplt_geom as geom;
pub use hplt_io as io;
pub use hplt_kdtree as kdtree;
pub use hplt_reference as reference;
pub use hplt_sampling as sampling;
pub use hplt_splat as splat;
pub use hplt_transport as transport;
