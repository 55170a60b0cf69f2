//! Parser from XML text to a tree of elements.

use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

use crate::Error;

/// An XML element. Text and comments are dropped: a model description has no data in them.
#[derive(Debug)]
pub(crate) struct Element {
    /// Tag.
    pub(crate) tag: String,
    /// Attributes: names and unescaped values.
    attributes: Vec<(String, String)>,
    /// Child elements, in order.
    pub(crate) children: Vec<Element>,
}

impl Element {
    /// Parses a document and returns its root. Refuses text that is not XML, or has no root or more than one.
    pub(crate) fn parse(xml: &str) -> Result<Self, Error> {
        let mut reader = Reader::from_str(xml);
        // A stack of open elements; the bottom element is the document and receives the root.
        let mut open = vec![Self { tag: "document".to_owned(), attributes: Vec::new(), children: Vec::new() }];
        loop {
            let event = reader.read_event().map_err(|error| Error(format!("byte {}: {error}", reader.error_position())))?;
            match event {
                Event::Start(start) => open.push(Self::open(&start)?),
                Event::Empty(start) => {
                    let element = Self::open(&start)?;
                    open.last_mut().expect("the document").children.push(element);
                }
                // The reader has checked that the tag closes the innermost open element.
                Event::End(_) => {
                    let element = open.pop().expect("an open element");
                    open.last_mut().expect("the document").children.push(element);
                }
                Event::Eof => break,
                _ => {}
            }
        }
        match (open.pop(), open.is_empty()) {
            (Some(document), true) if document.children.len() == 1 => Ok(document.children.into_iter().next().expect("one child")),
            (Some(element), false) => Err(Error(format!("<{}> is not closed", element.tag))),
            _ => Err(Error("a document has exactly one root element".to_owned())),
        }
    }

    fn open(start: &BytesStart<'_>) -> Result<Self, Error> {
        let tag = start.name().0.to_owned();
        let mut attributes = Vec::new();
        for attribute in start.attributes() {
            let attribute = attribute.map_err(|error| Error(format!("<{tag}>: {error}")))?;
            let value = attribute.normalized_value(XmlVersion::Explicit1_0).map_err(|error| Error(format!("<{tag}>: {error}")))?;
            attributes.push((attribute.key.0.to_owned(), value.into_owned()));
        }
        Ok(Self { tag, attributes, children: Vec::new() })
    }

    /// Value of an attribute, if it is given.
    pub(crate) fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// Value of an attribute; refuses an element without it.
    pub(crate) fn required(&self, name: &str) -> Result<&str, Error> {
        self.attribute(name).ok_or_else(|| Error(format!("{self} has no attribute {name}")))
    }

    /// The first child with this tag; refuses an element without one.
    pub(crate) fn child(&self, tag: &str) -> Result<&Element, Error> {
        self.children.iter().find(|child| child.tag == tag).ok_or_else(|| Error(format!("{self} has no element <{tag}>")))
    }

    /// Refuses attributes that are not in `allowed`, so that a misspelt attribute is noticed.
    pub(crate) fn allow(&self, allowed: &[&str]) -> Result<(), Error> {
        match self.attributes.iter().find(|(key, _)| !allowed.contains(&key.as_str())) {
            Some((key, _)) => Err(Error(format!("{self}: attribute {key} is not one of {}", allowed.join(", ")))),
            None => Ok(()),
        }
    }
}

impl std::fmt::Display for Element {
    /// Tag and name of the element, for messages.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.attribute("name") {
            Some(name) => write!(f, "<{} name=\"{name}\">", self.tag),
            None => write!(f, "<{}>", self.tag),
        }
    }
}
