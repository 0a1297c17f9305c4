use crate::{Error, Limits, LoadReport};

/// A material as a library describes it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Entry {
    pub(super) name: String,
    /// `Kd`.
    pub(super) diffuse: Option<[f32; 3]>,
    /// `Ke`, radiance.
    pub(super) emission: Option<[f32; 3]>,
    /// `map_Kd`.
    pub(super) diffuse_map: Option<String>,
    /// `map_Ke`.
    pub(super) emission_map: Option<String>,
}

/// The materials of a library.
pub(super) fn parse(bytes: &[u8], limits: &Limits, report: &mut LoadReport) -> Result<Vec<Entry>, Error> {
    let mut entries: Vec<Entry> = Vec::new();
    for (i, line) in bytes.split(|&b| b == b'\n').enumerate() {
        let place = format!("line {}", i + 1);
        if line.len() as u64 > limits.line_bytes {
            return Err(Error::limit(place, "LIMIT_LINE", "bytes", line.len() as u64, limits.line_bytes));
        }
        let text = String::from_utf8_lossy(line);
        let text = text.trim();
        let (keyword, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
        let rest = rest.trim();
        if keyword == "newmtl" {
            entries.push(Entry { name: rest.to_owned(), ..Entry::default() });
            continue;
        }
        let Some(entry) = entries.last_mut() else { continue };
        match keyword {
            "Kd" => entry.diffuse = color(rest, &place)?,
            "Ke" => entry.emission = color(rest, &place)?,
            "map_Kd" => entry.diffuse_map = Some(file_name(rest, &entry.name, report)),
            "map_Ke" => entry.emission_map = Some(file_name(rest, &entry.name, report)),
            "d" | "Tr" | "Tf" | "map_d" if !is_opaque(keyword, rest) => {
                report.leave_out(format!("material \"{}\": transparency ({keyword}); treated as opaque", entry.name));
            }
            _ => {}
        }
    }
    Ok(entries)
}

/// One number for grey or three; `None` for spectra and XYZ, which are not read.
fn color(text: &str, place: &str) -> Result<Option<[f32; 3]>, Error> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let number = |word: &str| {
        word.parse::<f32>().map_err(|_| {
            let message = format!("\"{}\"; expected a number", crate::sanitized(word));
            Error::invalid(place, "MTL_SYNTAX", message)
        })
    };
    match words[..] {
        ["spectral" | "xyz", ..] => Ok(None),
        [grey] => Ok(Some([number(grey)?; 3])),
        [r, g, b] => Ok(Some([number(r)?, number(g)?, number(b)?])),
        _ => Err(Error::invalid(place, "MTL_SYNTAX", format!("{} numbers; expected 3", words.len()))),
    }
}

/// The file behind the options of a map, which are ignored.
fn file_name(text: &str, material: &str, report: &mut LoadReport) -> String {
    let mut rest = text;
    while let Some(option) = rest.strip_prefix('-') {
        report.leave_out(format!("material \"{material}\": options of texture maps (-o, -s, -clamp and so on)"));
        let name_end = option.find(char::is_whitespace).unwrap_or(option.len());
        rest = option[name_end..].trim_start();
        // Values: numbers, or a word that switches something.
        while let Some(end) = rest.find(char::is_whitespace) {
            let word = &rest[..end];
            let is_channel = &option[..name_end] == "imfchan" || &option[..name_end] == "type";
            if word.parse::<f64>().is_err() && word != "on" && word != "off" && !is_channel {
                break;
            }
            rest = rest[end..].trim_start();
            if is_channel {
                break;
            }
        }
    }
    rest.to_owned()
}

fn is_opaque(keyword: &str, text: &str) -> bool {
    let first = text.split_whitespace().next().and_then(|w| w.parse::<f32>().ok());
    match keyword {
        "d" => first == Some(1.0),
        "Tr" => first == Some(0.0),
        "Tf" => text.split_whitespace().all(|w| w.parse::<f32>().ok() == Some(1.0)),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_emission_and_maps_are_read() {
        let text = b"Kd 9 9 9\nnewmtl a b\r\nKd 0.1 0.2 0.3\r\n\tKe 17 12 4\nmap_Kd -s 2 2 1 -clamp on my wall.png\n\
            d 0.5\nnewmtl grey\nKd .5\nmap_Ke glow.png\nnewmtl s\nKd spectral x.rfl 1";
        let mut report = LoadReport::default();
        let entries = parse(text, &Limits::default(), &mut report).unwrap();
        assert_eq!(entries[0].name, "a b");
        assert_eq!((entries[0].diffuse, entries[0].emission), (Some([0.1, 0.2, 0.3]), Some([17.0, 12.0, 4.0])));
        assert_eq!(entries[0].diffuse_map.as_deref(), Some("my wall.png"));
        assert_eq!((entries[1].diffuse, entries[1].emission_map.as_deref()), (Some([0.5; 3]), Some("glow.png")));
        assert_eq!(entries[2].diffuse, None);
        assert_eq!(report.left_out.len(), 2, "{:?}", report.left_out);
    }

    #[test]
    fn bad_numbers_name_their_line() {
        for text in ["newmtl a\nKd x 1 1", "newmtl a\nKd 1 2", "newmtl a\nKe 1 2 3 4"] {
            let error = parse(text.as_bytes(), &Limits::default(), &mut LoadReport::default()).unwrap_err();
            assert_eq!(error.code(), "MTL_SYNTAX");
            assert!(error.to_string().starts_with("line 2: "), "{error}");
        }
    }
}
