//! Folders that fmuResourceLocation may mean (FMI 2.0.4, section 2.1.5), in the forms that masters use.
//!
//! | form | example |
//! | --- | --- |
//! | URI | `file:///tmp/a%20b/resources`, `file:/tmp/resources`, `file://localhost/tmp/resources` |
//! | URI of Windows | `file:///C:/unit/resources`, `file://C:/unit/resources`, `file://server/share/resources` |
//! | plain path | `/tmp/a b/resources`, `C:\unit\resources` |

use std::path::PathBuf;

use percent_encoding::percent_decode;

/// Folders that a location may mean, the likeliest first. In a URI percent escapes are decoded, in a path they are kept; the other reading
/// comes second, because masters differ. Empty if the location belongs to another machine.
pub(super) fn folders(location: &[u8], windows: bool) -> Vec<PathBuf> {
    let (written, is_uri) = match after_scheme(location) {
        None => (location, false),
        Some(rest) => match path_of_uri(rest, windows) {
            Some(path) => (path, true),
            None => return Vec::new(),
        },
    };
    let (written, decoded) = (written.to_vec(), percent_decode(written).collect::<Vec<u8>>());
    let mut readings = if is_uri { vec![decoded, written] } else { vec![written, decoded] };
    readings.dedup();
    readings.into_iter().filter_map(path).collect()
}

/// Rest of a URI after `file:`; `None` if the location is not such a URI.
fn after_scheme(location: &[u8]) -> Option<&[u8]> {
    const SCHEME: &[u8] = b"file:";
    location.split_at_checked(SCHEME.len()).filter(|(scheme, _)| scheme.eq_ignore_ascii_case(SCHEME)).map(|(_, rest)| rest)
}

/// Path of a URI, still percent-encoded, from the part after `file:`. `None` if its host is another machine that has no path here.
fn path_of_uri(rest: &[u8], windows: bool) -> Option<&[u8]> {
    let path = match rest.strip_prefix(b"//") {
        None => rest,
        Some(after) => {
            let end = after.iter().position(|byte| matches!(byte, b'/' | b'\\')).unwrap_or(after.len());
            match &after[..end] {
                host if host.is_empty() || host.eq_ignore_ascii_case(b"localhost") => &after[end..],
                host if windows && begins_with_drive(host) => after,
                // A network folder of Windows, `//server/share/resources`.
                _ if windows => rest,
                _ => return None,
            }
        }
    };
    Some(match path {
        [b'/', drive @ ..] if windows && begins_with_drive(drive) => drive,
        _ => path,
    })
}

fn begins_with_drive(path: &[u8]) -> bool {
    matches!(path, [letter, b':', ..] if letter.is_ascii_alphabetic())
}

/// Bytes as a path. On Unix names are bytes; elsewhere they are text, and bytes that are not UTF-8 give `None`.
#[cfg(unix)]
fn path(bytes: Vec<u8>) -> Option<PathBuf> {
    use std::os::unix::ffi::OsStringExt;
    Some(std::ffi::OsString::from_vec(bytes).into())
}

#[cfg(not(unix))]
fn path(bytes: Vec<u8>) -> Option<PathBuf> {
    String::from_utf8(bytes).ok().map(PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(location: &str, windows: bool) -> Vec<String> {
        let folders = folders(location.as_bytes(), windows);
        folders.into_iter().map(|folder| folder.to_str().expect("UTF-8").to_owned()).collect()
    }

    #[test]
    fn every_form_that_masters_give_leads_to_its_folder() {
        for (location, folder) in [
            ("file:///tmp/unit/resources", "/tmp/unit/resources"),
            ("file:/tmp/unit/resources", "/tmp/unit/resources"),
            ("file://localhost/tmp/unit/resources", "/tmp/unit/resources"),
            ("FILE://LocalHost/tmp/unit/resources/", "/tmp/unit/resources/"),
            ("file:///tmp/two%20words/f%C3%BChrung%25/resources", "/tmp/two words/führung%/resources"),
            ("file:///tmp/two words/führung/resources", "/tmp/two words/führung/resources"),
            ("/tmp/two words/führung/resources", "/tmp/two words/führung/resources"),
            ("unit/resources", "unit/resources"),
        ] {
            assert_eq!(found(location, false)[0], folder, "{location}");
        }
        for (location, folder) in [
            ("file:///C:/unit/resources", "C:/unit/resources"),
            ("file:/C:/unit/resources", "C:/unit/resources"),
            ("file://localhost/C:/two%20words/resources", "C:/two words/resources"),
            ("file://C:/unit/resources", "C:/unit/resources"),
            (r"file://C:\unit\resources", r"C:\unit\resources"),
            (r"C:\f%C3%BChrung\resources", r"C:\f%C3%BChrung\resources"),
            ("file://server/share/resources", "//server/share/resources"),
            ("file:////server/share/resources", "//server/share/resources"),
        ] {
            assert_eq!(found(location, true)[0], folder, "{location}");
        }
    }

    #[test]
    fn the_other_reading_of_escapes_comes_second() {
        assert_eq!(found("file:///tmp/100%25/r", false), ["/tmp/100%/r", "/tmp/100%25/r"]);
        assert_eq!(found("/tmp/a%20b/r", false), ["/tmp/a%20b/r", "/tmp/a b/r"]);
        assert_eq!(found("/tmp/100% done/r", false), ["/tmp/100% done/r"]);
    }

    #[test]
    fn a_location_on_another_machine_is_no_folder_here() {
        assert_eq!(found("file://server/share/resources", false), [""; 0]);
        assert_eq!(found("file://resources", false), [""; 0]);
    }

    #[cfg(unix)]
    #[test]
    fn names_that_are_no_text_are_kept() {
        use std::os::unix::ffi::OsStrExt;
        assert_eq!(folders(b"file:///tmp/%FF", false)[0].as_os_str().as_bytes(), b"/tmp/\xff");
    }
}
