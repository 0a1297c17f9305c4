//! hplt-transport
