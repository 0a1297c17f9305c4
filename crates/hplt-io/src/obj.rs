use std::path::Path;

use crate::{Error, LoadOptions, Loaded};

pub(crate) fn load(path: &Path, _: &LoadOptions) -> Result<Loaded, Error> {
    Err(Error::read(path, std::io::Error::from(std::io::ErrorKind::Unsupported)))
}
