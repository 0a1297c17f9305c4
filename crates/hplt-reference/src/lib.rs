//! hplt-reference
