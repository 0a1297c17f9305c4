//! hplt-io
