//! hplt-splat
