//! Edits of the XML text that keep every comment and line break.

use quick_xml::Writer;
use quick_xml::events::{BytesStart, Event};

pub(crate) fn write(writer: &mut Writer<Vec<u8>>, event: Event<'_>) {
    writer.write_event(event).expect("writing to memory does not fail");
}

/// Value of an attribute, if the element has it.
pub(crate) fn value(element: &BytesStart<'_>, name: &str) -> Option<String> {
    let attribute = element.try_get_attribute(name).expect("parse() has read the same element before");
    attribute.map(|attribute| attribute.value.into_owned())
}

/// Replaces the value of one attribute, escaped; line breaks between the attributes are kept.
pub(crate) fn replace(element: &BytesStart<'_>, name: &str, new: &str) -> BytesStart<'static> {
    let old = value(element, name).unwrap_or_default();
    let content = format!("{}{}", element.name().0, element.attributes_raw());
    // The blank before the name distinguishes `version` from `fmiVersion`.
    let pattern = |blank: char| format!("{blank}{name}=\"{old}\"");
    let content = [' ', '\n']
        .into_iter()
        .fold(content, |content, blank| content.replacen(&pattern(blank), &format!("{blank}{name}=\"{new}\""), 1));
    BytesStart::from_content(content, element.name().0.len())
}
