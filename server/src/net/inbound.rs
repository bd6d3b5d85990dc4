//! Reads a client's messages. Each is carried out, passed to the session, or answered with one error.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::body::Bytes;
use futures_util::StreamExt;
use futures_util::stream::SplitStream;
use ghostlight_proto::control::{Asset, Credit, Done, ErrorReport, Pong, Reply, Request};
use ghostlight_proto::{AssetChunk, Code, Frame, Intrinsics, Kind, WireError};
use tokio::sync::{mpsc, watch};
use tokio::time::timeout;

use super::close::{CloseReason, unreadable};
use super::hub::{Hub, SessionHandle};
use super::outbound::UnderWay;
use super::peek;
use super::session::{Command, Incoming};
use super::socket::{Message, Socket, SocketError, close_code};
use crate::clock;

/// Most concurrent uploads of one client.
const MAX_UPLOADS: usize = 16;

/// Longest name of an asset, bytes.
const MAX_ASSET_NAME: usize = 128;

struct Upload {
    id: Option<u64>,
    name: String,
    bytes: u64,
    content: Vec<u8>,
}

/// The reading half of a connection.
pub(super) struct Inbound<'a> {
    hub: &'a Hub,
    handle: &'a SessionHandle,
    producer: bool,
    answers: mpsc::Sender<Reply>,
    under_way: &'a watch::Sender<UnderWay>,
    uploads: BTreeMap<u32, Upload>,
}

/// The message that an error refers to.
#[derive(Default)]
struct About {
    id: Option<u64>,
    sequence: Option<u64>,
}

impl<'a> Inbound<'a> {
    /// Replies are sent to `answers`; acknowledged composites are removed from `under_way`.
    pub(super) fn new(
        hub: &'a Arc<Hub>,
        handle: &'a SessionHandle,
        producer: bool,
        answers: mpsc::Sender<Reply>,
        under_way: &'a watch::Sender<UnderWay>,
    ) -> Self {
        Self {
            hub,
            handle,
            producer,
            answers,
            under_way,
            uploads: BTreeMap::new(),
        }
    }

    /// Reads until the client leaves (`None`) or must be closed.
    pub(super) async fn run(&mut self, stream: &mut SplitStream<Socket>) -> Option<CloseReason> {
        loop {
            let message = match timeout(self.hub.config.bounds.idle, stream.next()).await {
                Err(_) => {
                    return Some(CloseReason::new(
                        close_code::POLICY,
                        "idle: no message and no pong",
                    ));
                }
                Ok(None | Some(Ok(Message::Close(_)))) => return None,
                Ok(Some(Err(error))) => return self.broken(&error).await,
                Ok(Some(Ok(message))) => message,
            };
            let mut about = About::default();
            let result = match message {
                Message::Binary(bytes) => self.binary(bytes, &mut about).await,
                Message::Text(text) => match self.text(&text, &mut about).await {
                    Ok(Some(close_reason)) => return Some(close_reason),
                    Ok(None) => Ok(()),
                    Err(error) => Err(error),
                },
                // The reader never delivers raw frames.
                Message::Ping(_) | Message::Pong(_) | Message::Close(_) | Message::Frame(_) => {
                    Ok(())
                }
            };
            if let Err(error) = result {
                if about.sequence.is_some() {
                    self.handle.session.count_refused(error.code);
                } else {
                    self.hub.metrics.error(error.code);
                }
                let report = ErrorReport::new(error, about.id, about.sequence, false);
                self.answer(Reply::Error(report)).await;
            }
        }
    }

    /// Answers a failed read; `None` if the client has left.
    async fn broken(&mut self, error: &SocketError) -> Option<CloseReason> {
        let (error, close_reason) = unreadable(self.hub, error)?;
        self.hub.metrics.error(error.code);
        let report = ErrorReport::new(error, None, None, true);
        self.answer(Reply::Error(report)).await;
        Some(close_reason)
    }

    /// Waits until the queue of answers has room: backpressure for clients that do not read.
    async fn answer(&self, reply: Reply) {
        // Fails only if the writing half has ended; this half then ends too.
        let _ = self.answers.send(reply).await;
    }

    async fn binary(&mut self, message: Bytes, about: &mut About) -> Result<(), WireError> {
        let limit = self.hub.config.bounds.message_bytes;
        if message.len() > limit {
            return Err(WireError::new(
                Code::TooLarge,
                "message",
                format_args!("at most {limit} bytes"),
                format_args!("{} bytes", message.len()),
            ));
        }
        match Kind::of(&message)? {
            Kind::Frame => self.frame(message, about),
            Kind::AssetChunk => self.chunk(&message, about).await,
            Kind::Composite => Err(WireError::new(
                Code::UnknownType,
                "binary message, kind",
                "1 (frame) or 3 (asset chunk)",
                "2 (composite)",
            )),
        }
    }

    fn frame(&mut self, message: Bytes, about: &mut About) -> Result<(), WireError> {
        let received_ns = clock::now_ns();
        // The sequence number has a fixed position, so it is known even if the rest is wrong.
        about.sequence = Some(
            message
                .get(8..16)
                .and_then(|b| b.try_into().ok())
                .map_or(0, u64::from_le_bytes),
        );
        if !self.producer {
            return Err(WireError::new(
                Code::Forbidden,
                "frame",
                "frames from producers only",
                "a frame from a viewer",
            ));
        }
        let header = Frame::decode(&message)?.header;
        self.check_size("frame colour", &header.color)?;
        self.check_size("frame depth", &header.depth)?;
        self.handle.session.offer(Incoming {
            header,
            message,
            received_ns,
            reply: self.answers.clone(),
        });
        Ok(())
    }

    fn check_size(&self, what: &str, k: &Intrinsics) -> Result<(), WireError> {
        let bounds = &self.hub.config.bounds;
        if k.width.max(k.height) <= bounds.side_px && k.n_pixels() <= bounds.pixels {
            return Ok(());
        }
        Err(WireError::new(
            Code::TooLarge,
            format_args!("{what} size"),
            format_args!(
                "sides of at most {} and at most {} pixels",
                bounds.side_px, bounds.pixels
            ),
            format_args!("{}x{}", k.width, k.height),
        ))
    }

    /// Returns `Ok(Some)` if the client says good-bye.
    async fn text(
        &mut self,
        text: &str,
        about: &mut About,
    ) -> Result<Option<CloseReason>, WireError> {
        let limit = self.hub.config.bounds.scene_bytes;
        if text.len() > limit {
            about.id = peek::id_of(text);
            return Err(WireError::new(
                Code::TooLarge,
                "text message",
                format_args!("at most {limit} bytes"),
                format_args!("{} bytes", text.len()),
            ));
        }
        let (id, request) = Request::parse(text);
        about.id = id;
        match request? {
            Request::Hello(_) => Err(WireError::new(
                Code::Hello,
                "hello",
                "one, as the first message",
                "another",
            )),
            Request::Credit(credit) => {
                self.credited(&credit);
                Ok(None)
            }
            Request::Planes(planes) => {
                self.handle.change_planes(planes)?;
                self.done(id, "planes").await;
                Ok(None)
            }
            Request::Ping(ping) => {
                let clock_us = clock::now_us();
                self.answer(Reply::Pong(Pong {
                    t: ping.t,
                    clock_us,
                }))
                .await;
                Ok(None)
            }
            Request::Bye(bye) => Ok(Some(CloseReason::new(close_code::NORMAL, bye.reason))),
            Request::Asset(asset) => {
                self.may_change("asset")?;
                self.announce(id, asset).await?;
                Ok(None)
            }
            request => {
                self.may_change(request.kind())?;
                self.handle.session.request(Command {
                    id,
                    request,
                    reply: self.answers.clone(),
                });
                Ok(None)
            }
        }
    }

    /// Returns credits. The client's reported times count only if it had a composite to draw.
    fn credited(&self, credit: &Credit) {
        let now_ns = clock::now_ns();
        let metrics = &self.hub.metrics;
        self.under_way.send_if_modified(|under_way| {
            let n = under_way.len().min(credit.n as usize);
            for received_ns in under_way.drain(..n) {
                metrics.credited(now_ns - received_ns);
            }
            if n > 0 {
                metrics.drawn(credit.latency_us, credit.draw_us);
            }
            n > 0
        });
    }

    async fn done(&self, id: Option<u64>, request: &str) {
        let request = request.to_owned();
        let note = None;
        self.answer(Reply::Done(Done { id, request, note })).await;
    }

    fn may_change(&self, what: &str) -> Result<(), WireError> {
        if self.handle.control {
            return Ok(());
        }
        Err(WireError::new(
            Code::Forbidden,
            what,
            "a client that may change the session",
            "a client that only watches",
        ))
    }

    async fn announce(&mut self, id: Option<u64>, asset: Asset) -> Result<(), WireError> {
        let refuse = |what: &str, expected: String, got: String| {
            Err(WireError::new(Code::Asset, what, expected, got))
        };
        // A plain file name, without folders.
        let plain = asset
            .name
            .bytes()
            .all(|b| b.is_ascii_alphanumeric() || b"._- ".contains(&b))
            && !asset.name.starts_with(['.', ' ']);
        if asset.name.is_empty() || asset.name.len() > MAX_ASSET_NAME || !plain {
            return refuse(
                "asset, name",
                format!(
                    "1 to {MAX_ASSET_NAME} of A-Z a-z 0-9 . _ - and space, not starting with . or space"
                ),
                format!("{:?}", asset.name),
            );
        }
        if asset.bytes == 0 {
            return refuse("asset, bytes", "at least 1".to_owned(), "0".to_owned());
        }
        if self.uploads.contains_key(&asset.upload) || self.uploads.len() >= MAX_UPLOADS {
            return refuse(
                "asset, upload",
                format!("a number not in use, and at most {MAX_UPLOADS} uploads at a time"),
                asset.upload.to_string(),
            );
        }
        self.handle
            .session
            .reserve_upload(&asset.name, asset.bytes, &self.hub.config.bounds)?;
        let upload = Upload {
            id,
            name: asset.name,
            bytes: asset.bytes,
            content: Vec::new(),
        };
        self.uploads.insert(asset.upload, upload);
        Ok(())
    }

    async fn chunk(&mut self, message: &Bytes, about: &mut About) -> Result<(), WireError> {
        let chunk = AssetChunk::decode(message)?;
        let Some(upload) = self.uploads.get_mut(&chunk.upload) else {
            return Err(WireError::new(
                Code::Asset,
                "asset chunk, upload",
                "one that was announced",
                chunk.upload,
            ));
        };
        about.id = upload.id;
        let (have, left) = (
            upload.content.len() as u64,
            upload.bytes - upload.content.len() as u64,
        );
        let wrong = if chunk.offset != have {
            Some(("asset chunk, offset", format!("{have}"), chunk.offset))
        } else if chunk.bytes.len() as u64 > left {
            let got = chunk.bytes.len() as u64;
            Some(("asset chunk, bytes", format!("at most {left}"), got))
        } else {
            None
        };
        if let Some((what, expected, got)) = wrong {
            let error = WireError::new(Code::Asset, what, expected, got);
            self.drop_upload(chunk.upload);
            return Err(error);
        }
        upload.content.extend_from_slice(chunk.bytes);
        if upload.content.len() as u64 == upload.bytes
            && let Some(upload) = self.uploads.remove(&chunk.upload)
        {
            let finished = Some((upload.name, upload.content));
            self.handle.session.settle_upload(upload.bytes, finished);
            self.done(upload.id, "asset").await;
        }
        Ok(())
    }

    fn drop_upload(&mut self, number: u32) {
        if let Some(upload) = self.uploads.remove(&number) {
            self.handle.session.settle_upload(upload.bytes, None);
        }
    }
}

impl Drop for Inbound<'_> {
    fn drop(&mut self) {
        for upload in self.uploads.values() {
            self.handle.session.settle_upload(upload.bytes, None);
        }
    }
}
