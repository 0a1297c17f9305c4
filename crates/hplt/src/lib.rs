//! hplt
